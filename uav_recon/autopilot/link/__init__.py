"""The link to one vehicle: sending, receiving, time synchronisation, alerts."""
