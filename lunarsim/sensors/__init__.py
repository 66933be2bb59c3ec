"""Sensors: each turns the true world and state into a measurement with its own noise figures."""

from lunarsim.sensors.camera import Camera, Photograph
from lunarsim.sensors.lidar import FlashLidar, LidarScan

__all__ = ["Camera", "FlashLidar", "LidarScan", "Photograph"]
