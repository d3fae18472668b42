"""The closed loop, its guard, its record and numbers, and many loops at once."""
