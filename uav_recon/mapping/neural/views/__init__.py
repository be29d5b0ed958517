"""What keyframes bring: their rays and depth images, which are taken and kept, and how they are made to agree."""
