"""Files to values and back: meshes, views, cameras, pictures."""
import logging

for _library in ("trimesh", "PIL"):  # what they log reaches a handler of the program's, if it has one, and never stderr by itself
    logging.getLogger(_library).addHandler(logging.NullHandler())
