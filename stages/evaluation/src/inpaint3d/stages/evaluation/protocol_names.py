"""What the protocols and their baselines are called, and what they say of ranges and networks."""

BOX = "bbox10-vgg"
SPIN_NERF = "spin-nerf"
HOLE = "masked-pixels"
FULL = "full"
HELD_OUT = "held-out-known-pixels"
SAMPLES = "held-out-samples"
STATISTICS = "hole-statistics"
CONSISTENCY = "neighbouring-views"
VARIETY = "between-seeds"
EACH_PAIR = "all pairs"
MEAN_SURROUND = "mean-surround"
MEAN_COLOUR = "mean-colour"
WARPED = "nearest-photo-warped"

SRGB = "sRGB-encoded, 0 to 1"
LPIPS_NETWORKS = ("LPIPS v0.1 VGG16", "LPIPS v0.1 AlexNet")
LITE0 = "EfficientNet-Lite0, 1280 pooled features"

Z_TOLERANCE = 0.02
"""Share of a depth by which the neighbour's own may differ for it to be the same surface."""
