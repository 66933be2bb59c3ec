"""Figures that both sides know: the lander's, and those of sensors without the world they see."""
