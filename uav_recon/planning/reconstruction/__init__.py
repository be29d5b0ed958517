"""Views that improve the reconstruction: surface elements, gains, candidate views."""
