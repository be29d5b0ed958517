"""Situation: poses, surroundings, estimate and intent, as the pilot knows them."""
