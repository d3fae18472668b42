"""Videos: the scene, the head-up display, the encoder."""
