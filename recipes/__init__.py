"""Recipes that ship with me3bev."""
