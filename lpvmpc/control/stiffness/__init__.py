"""What the axles' lateral force does next: the models that adapt the controller."""
