"""Built-in spatial plugins."""
