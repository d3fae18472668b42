"""What is driven: paths, speeds, wind, friction, track files, and scenarios made of them."""
