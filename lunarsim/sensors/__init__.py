"""Sensors: each turns the true world and state into a measurement with its own noise figures."""

from lunarsim.sensors.altimeter import AltimeterReading, RadarAltimeter
from lunarsim.sensors.camera import Camera, Photograph
from lunarsim.sensors.gimbal import gimbal_mount
from lunarsim.sensors.imu import Imu, InertialErrors
from lunarsim.sensors.lidar import FlashLidar, LidarScan
from lunarsim.sensors.scanning import ScanningLidar

__all__ = [
    "AltimeterReading",
    "Camera",
    "FlashLidar",
    "Imu",
    "InertialErrors",
    "LidarScan",
    "Photograph",
    "RadarAltimeter",
    "ScanningLidar",
    "gimbal_mount",
]
