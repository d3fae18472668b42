"""Other road users: who they are, how near they come, and a reference that goes round them."""
