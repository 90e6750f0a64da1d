"""Graph decisions: frozen value in, frozen value out; no Vulkan, no text."""
