"""Control: converts a commanded thrust acceleration to throttle, attitude and torque."""
