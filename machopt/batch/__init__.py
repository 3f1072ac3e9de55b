"""``machopt batch``: many cells × toolpaths × options, each job in a process of its own, resumable.

::

    folder, pattern, list ─find─► jobs ─key─► what is finished already? ─engine (Dask)─► workers
                                                                                         │ supervise: limits
    summary.csv/.html, batch.json ◄─summary─ records ◄─store: one rename a job─ driver ◄─┘ nursery: fork a job

A Dask task supervises one job; the job itself runs in a process that the task starts, limits and reaps, so nothing it
does to itself reaches the worker or another job. Only the driver, which holds the lock of the output folder, moves a
finished job into it, by one rename that carries the result and its record: a job is in the folder wholly or not at all.
"""
