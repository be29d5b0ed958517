"""Records of a flight: event log, rerun recording, report with plots, timelapse, viewer."""
