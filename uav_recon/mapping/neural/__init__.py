"""Neural implicit mapper: signed distance, colour and surface uncertainty, learned online."""
