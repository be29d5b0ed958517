"""The setpoint benchmark: gaps in the setpoint stream at the receiver, under load."""
