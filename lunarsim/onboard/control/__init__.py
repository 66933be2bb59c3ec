"""From a wanted thrust acceleration to throttle, attitude and torque."""
