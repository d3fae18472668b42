"""The leaderboard: every controller over roads, worlds, grip, friction, wind and seeds."""
