"""Cutting coefficients, run-out and angular offset from force waveforms, by nonlinear least squares.

::

    WaveformRecording ─► signal_checks ─► start_values ─► waveform_fit ─► waveform_fit_pipeline ─► CoefficientFit,
                         revolutions,     speed, offset,  Gauss–Newton,   means of the cuts,       WaveformResult
                         sampling rate    run-out         covariance      intervals
                                                          ▲        ▲
                                                          │        └─ residual_noise: autoregression, periodic misfit
                                                          └─ waveform_model ◄─ chip_integrals: exact derivatives

Force of sample i: F = Σ_q K_q B_q(φ_i, c, ρ_c, ρ_s), with six integrals B over the engaged edges, and
φ = φ_0 + ω (1 + δ)(t − t_m) (time), or φ = φ_0 + angle. Unknowns: six coefficients K, the run-out
(ρ_c, ρ_s) = ρ (cos λ, sin λ), and for each cut φ_0 and, over time, the relative error δ of the spindle speed.

Run-out is in Cartesian form, so that the model is differentiable at ρ = 0. Which tooth has number 0 is a convention:
the one nearest to the offset, |λ| ≤ π/N. The residuals of each force are whitened by an autoregression. Where the
residuals repeat with the rotation, the model lacks something; the covariance is multiplied by that repeatable part over
what noise alone makes. CasADi is imported by ``chip_integrals`` only, and that module only for a waveform.

Sources: Altıntaş, Manufacturing Automation, 2nd ed. (2012), section 2.8; run-out: Kline & DeVor, Int. J. Mach. Tool
Des. Res. 23 (1983) 123; autoregression: Box, Jenkins & Reinsel, Time Series Analysis, 4th ed. (2008), section 7.3.
"""
