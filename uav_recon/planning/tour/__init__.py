"""Selection and order of the tasks to fly."""
