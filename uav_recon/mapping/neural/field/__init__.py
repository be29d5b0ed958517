"""The learned field itself, and one step of learning: the CPU kernels."""
