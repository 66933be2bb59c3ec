"""Control: from a commanded acceleration to throttle, attitude and torque."""
