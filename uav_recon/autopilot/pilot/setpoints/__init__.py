"""Setpoints: the motion that is proposed to the guard."""
