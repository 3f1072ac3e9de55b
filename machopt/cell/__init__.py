"""Read the files of a robot cell: cell.yaml, URDF, meshes, stiffness.yaml and kinematics.yaml."""
