"""Checks that keep an effect from being named for what another one causes."""
