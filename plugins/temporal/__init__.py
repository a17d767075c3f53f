"""Built-in temporal plugins."""
