"""Scenes: built-in room, generated rooms, meshes, textures, rendering."""
