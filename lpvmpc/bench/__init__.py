"""What holds in which world, what adapting the stiffness is worth, how long a period takes."""
