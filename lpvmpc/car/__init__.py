"""The car's parameters and formulas: tire, axle, air, single track. No MuJoCo."""
