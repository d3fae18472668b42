"""A controller in a process of its own."""
