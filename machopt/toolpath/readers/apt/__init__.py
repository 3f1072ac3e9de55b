"""APT / cutter location data of NX, CATIA, Creo, CAMWorks, HSM/Fusion and others."""
