"""What compiler and runtime share: pure logic, no Vulkan, no graph."""
