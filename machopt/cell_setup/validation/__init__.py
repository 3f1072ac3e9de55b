"""List everything that is wrong or implausible in a cell (``machopt validate``)."""
