"""The MuJoCo car with its tire law inside the physics step."""
