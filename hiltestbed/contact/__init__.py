"""How the two mechanisms touch."""
