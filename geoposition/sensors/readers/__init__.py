"""One module per product format; each returns the types of the house."""
