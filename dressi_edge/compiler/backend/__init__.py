"""From packed stages to a bundle's description: GLSL, SPIR-V, images, needs."""
