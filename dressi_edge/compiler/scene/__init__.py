"""What a user builds with: scenes and problems in, programs out. `from dressi_edge.compiler.scene import F, Scene, Adam, ...` is all there
is to import; `F` has every op of the graph by name (docs/guide.md)."""
from ..graph import functions as F
from ..io.cameras import Camera, look_at, orbit
from ..io.meshes import Mesh, load_mesh
from ..io.shapes import icosphere, pear, sphere
from ..io.views import Views, load_views
from ..render.light import Light
from ..render.loss import (
    cotangent_laplacian,
    l1,
    l2,
    normal_consistency,
    uniform_laplacian,
)
from ..render.material import BlinnPhong, Lambert, Texture, Unlit, Vertex
from ..render.optimizer import Adam, Optimizer, Sgd
from ..render.raster import HardSoftRas, Outline, Renderer, Softness
from ..render.schedule import Schedule
from ..render.surface import Surface
from ..render.tone import encode_srgb
from .problem import Loss, Problem
from .scene import Scene

__all__ = ["Adam", "BlinnPhong", "Camera", "F", "HardSoftRas", "Lambert", "Light", "Loss", "Mesh", "Optimizer", "Outline", "Problem",
           "Renderer", "Scene", "Schedule", "Sgd", "Softness", "Surface", "Texture", "Unlit", "Vertex", "Views", "cotangent_laplacian",
           "encode_srgb", "icosphere", "l1", "l2", "load_mesh", "load_views", "look_at", "normal_consistency", "orbit", "pear", "sphere",
           "uniform_laplacian"]
