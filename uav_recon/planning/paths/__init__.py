"""Path search: lazy Theta*, string pulling, segment tests, path cache."""
