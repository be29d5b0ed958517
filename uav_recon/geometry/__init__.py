"""Geometry kernels shared by several stages: compilation decorators and ray traversal."""
