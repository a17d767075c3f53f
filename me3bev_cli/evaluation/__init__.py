"""Episode runner, reference drivers, metrics and tables."""
