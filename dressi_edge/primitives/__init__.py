"""The four functions of modular differentiable rendering (rasterize, interpolate, texture, antialias), compiled for the device at hand at
first use. `primitives.torch` has them for PyTorch, in the order of arguments of nvdiffrast; docs/primitives.md. Needs the compiler."""
