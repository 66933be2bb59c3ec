"""Descents in which an agent commands thrust and attitude or torques."""
