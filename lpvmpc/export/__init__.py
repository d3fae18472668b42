"""Runs for other tools: read back from their folder, and written as CSV and MCAP."""
