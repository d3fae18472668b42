"""What the car is compared with: closed forms, golden values, other models, broken cars."""
