"""Where one may fly, and the ways there."""
