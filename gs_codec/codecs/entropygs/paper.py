"""Figures published for EntropyGS (arXiv 2508.10227): means over Mip-NeRF 360, other machines."""

#: Overhead of the parametric models over Shannon entropy, in percent (Table 1).
OVERHEAD_PERCENT = {"rotation": 0.29, "scaling": 0.09, "opacity": 0.08, "sh-ac": 0.41}

#: Entropy per symbol, in bits (SH-AC at 4 bits).
ENTROPY_BITS = {"rotation": 6.243, "scaling": 6.769, "opacity": 6.337, "sh-ac": 2.436}

#: Seconds for its mean scene, after pruning.
SECONDS = {
    "CPU": {"encode": 16.4, "decode": 13.8},
    "RTX 3090": {"encode": 3.6, "decode": 0.2},
}

#: The paper's ablation: PSNR against photographs in dB, and megabytes, after each step.
ABLATION = {
    "original": (27.28, 760.1),
    "importance pruning": (25.54, 266.0),
    "geometry pruning": (25.45, 264.4),
    "optimisation": (27.42, 264.4),
    "quantisation": (27.24, 41.5),
    "entropy coding": (27.24, 32.2),
    "geometry coding": (27.24, 26.9),
}

#: Number of Gaussians of its mean scene, after pruning.
MEAN_GAUSSIANS = 1_120_000
