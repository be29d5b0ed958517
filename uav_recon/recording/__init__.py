"""Everything a flight leaves behind: recorder, review blueprint, report."""
