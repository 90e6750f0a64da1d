"""The graph: nodes over 2D images, the op table, differentiation, programs, the float64 reference."""
