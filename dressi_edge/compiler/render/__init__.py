"""Building blocks of problems, all plain graph: objectives, normals, optimizers, schedules."""
