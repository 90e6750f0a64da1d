"""Files to values and back: meshes, views, cameras, pictures."""
