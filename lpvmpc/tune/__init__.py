"""The improved genetic algorithm, the particle swarm, and the tuning of weights."""
