"""The field and its training step in torch: the same parameters and losses as the kernels, on a GPU or on several."""
