"""Recordings of real cars: replaying them on the plant, and identifying the car from them."""
