"""Gymnasium environments on lunarsim."""
