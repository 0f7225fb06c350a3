"""Every artifact that stages exchange: one metadata model each, under a versioned schema id.

The metadata names the files that hold the bulk; file layouts are described in each model. `SCHEMAS` is the registry.
"""

from inpaint3d.contracts.models.artifacts.capture import Capture, CapturedFrame, Exif, KnownCamera, Truth
from inpaint3d.contracts.models.artifacts.completion import (
    CompletedView,
    CompletedViews,
    Contradiction,
    PaintedView,
    PaintedViews,
    Painting,
)
from inpaint3d.contracts.models.artifacts.effects import Effect, EffectPlan, IgnoredFrame, Interval
from inpaint3d.contracts.models.artifacts.external import (
    DiffusersPipeline,
    ImageCorpus,
    MaskRequestArtifact,
    Segmenter,
    Source,
)
from inpaint3d.contracts.models.artifacts.field import FieldSpec, FieldView, GridSpec, RadianceFieldArtifact
from inpaint3d.contracts.models.artifacts.mask_sets import MaskSet, MaskView, NamedMask, Primitive, ViewOrder
from inpaint3d.contracts.models.artifacts.masks import MaskRequest
from inpaint3d.contracts.models.artifacts.plates import Canvas, CleanPlate, CleanPlates, PlateConsistency
from inpaint3d.contracts.models.artifacts.posed import (
    LensModel,
    MetricScale,
    PosedCapture,
    PosedFrame,
    PosedTruth,
    Registration,
)
from inpaint3d.contracts.models.artifacts.prior import DiffusionPrior, PriorSpec
from inpaint3d.contracts.models.artifacts.results import (
    Evaluation,
    MeshFidelity,
    Metric,
    PictureStrip,
    Protocol,
    UsdScene,
)
from inpaint3d.contracts.models.artifacts.splat_scene import SplatFidelity, SplatFormat, SplatScene
from inpaint3d.contracts.models.base import Closed

SCHEMAS: dict[str, tuple[str, type[Closed]]] = {
    "source": ("1.0", Source),
    "mask-request": ("1.0", MaskRequestArtifact),
    "image-corpus": ("1.0", ImageCorpus),
    "diffusers-pipeline": ("1.0", DiffusersPipeline),
    "segmenter": ("1.0", Segmenter),
    "capture": ("1.0", Capture),
    "truth": ("1.0", Truth),
    "posed-capture": ("1.0", PosedCapture),
    "posed-truth": ("1.0", PosedTruth),
    "effect-plan": ("1.0", EffectPlan),
    "radiance-field": ("1.1", RadianceFieldArtifact),
    "mask-set": ("1.0", MaskSet),
    "diffusion-prior": ("1.0", DiffusionPrior),
    "painted-views": ("1.0", PaintedViews),
    "completed-views": ("1.0", CompletedViews),
    "clean-plates": ("1.0", CleanPlates),
    "evaluation": ("1.0", Evaluation),
    "usd-scene": ("1.0", UsdScene),
    "splat-scene": ("1.0", SplatScene),
}
"""Artifact name -> (MAJOR.MINOR that this code writes, metadata model)."""

__all__ = [
    "SCHEMAS",
    "Canvas",
    "Capture",
    "CapturedFrame",
    "CleanPlate",
    "CleanPlates",
    "CompletedView",
    "CompletedViews",
    "Contradiction",
    "DiffusersPipeline",
    "DiffusionPrior",
    "Effect",
    "EffectPlan",
    "Evaluation",
    "Exif",
    "FieldSpec",
    "FieldView",
    "GridSpec",
    "IgnoredFrame",
    "ImageCorpus",
    "Interval",
    "KnownCamera",
    "LensModel",
    "MaskRequest",
    "MaskRequestArtifact",
    "MaskSet",
    "MaskView",
    "MeshFidelity",
    "Metric",
    "MetricScale",
    "NamedMask",
    "PaintedView",
    "PaintedViews",
    "Painting",
    "PictureStrip",
    "PlateConsistency",
    "PosedCapture",
    "PosedFrame",
    "PosedTruth",
    "Primitive",
    "PriorSpec",
    "Protocol",
    "RadianceFieldArtifact",
    "Registration",
    "Segmenter",
    "Source",
    "SplatFidelity",
    "SplatFormat",
    "SplatScene",
    "Truth",
    "UsdScene",
    "ViewOrder",
]
