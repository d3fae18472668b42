"""The evidence that ships: recordings made and replayed, docs/results/replay.md."""
