"""What several commands share, or one is too long for."""
