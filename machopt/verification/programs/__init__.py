"""Robot programs compared with the motion and with the CAM file."""
