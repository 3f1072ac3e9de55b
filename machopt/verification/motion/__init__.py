"""Independent check of an exported motion: own kinematics, collisions and stiffness."""
