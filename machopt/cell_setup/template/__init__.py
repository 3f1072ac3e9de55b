"""Write a new cell folder from a URDF (``machopt init``)."""
