"""From the words of a CAM reader to a list of points: arcs, cycles, frames, rotary axes."""
