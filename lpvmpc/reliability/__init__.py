"""What happens when things go wrong: wrong inputs, damaged files, roads nobody tuned for."""
