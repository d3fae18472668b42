"""What the car measures of itself, and the estimator between sensors and controller."""
