"""What adapting the stiffness is worth, and how long a period takes."""
