"""Commands on recordings of real cars: replay one, adopt its car."""
