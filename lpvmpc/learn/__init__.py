"""The cornering-stiffness data, and the networks that are trained on them."""
