"""What the scripts beside this folder make the example cells of: shapes, arms, controllers, one module a cell."""
