"""Static simulator of robots: rigid bodies in maximal coordinates, joined by bushings with six degrees of freedom.

Data flow: ``robot_assembly`` turns a robot description and hidden effects into ``MultibodyChain`` objects
(``bushing_bodies``),
``gear_laws`` gives each drive its windup, ``equilibrium`` solves force balance for a batch of postures,
``load_recording`` and
``pose_recording`` measure the result as a laboratory does, ``record_faults`` damages the record, ``case_list``
draws the cases,
``effect_size`` scales each effect to a ratio of the noise, ``case_files`` writes cell, recording and truth.
No file here imports machopt.
"""
