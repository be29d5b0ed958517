"""The final model: watertight mesh, texture atlas, export."""
