"""The semantic decoder, its training and its pictures."""
