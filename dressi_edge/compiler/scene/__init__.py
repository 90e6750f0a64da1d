"""What a user builds with: scenes and problems in, programs out. `from dressi_edge.compiler.scene import F, Scene, Adam, ...` is all there
is to import; `F` has every op of the graph by name (docs/guide.md)."""
from ..check_op import check_op
from ..graph import functions as F
from ..graph.optable import op
from ..io.cameras import Camera, look_along, look_at, orbit
from ..io.decode import Masks
from ..io.hull import visual_hull
from ..io.mesh import Mesh, corner_normals, linear_mesh
from ..io.meshes import load_mesh, load_parts
from ..io.panorama import load_panorama
from ..io.shapes import icosphere, pear, sphere
from ..io.views import Views, load_photographs, load_views
from ..io.writers import save_mesh, save_parts, save_png
from ..render.environment import Environment
from ..render.geometry import LargeSteps, blend_shapes, linear_model, rigid, similarity, skin
from ..render.light import Light, Shadow
from ..render.loss import (
    charbonnier,
    cotangent_laplacian,
    depth_loss,
    edge_length,
    face_points,
    huber,
    l1,
    l2,
    landmarks,
    mean_square,
    normal_consistency,
    normal_loss,
    pyramid_l1,
    ssim,
    ssim_loss,
    tint,
    total_variation,
    uniform_laplacian,
)
from ..render.material import BlinnPhong, Channel, Coordinates, Corner, Lambert, NormalMap, Occlusion, Product, Texture, Unlit, Vertex
from ..render.octahedron import octahedral, panorama
from ..render.optimizer import Adam, AdamUniform, AdamW, Clipped, Optimizer, Scaled, Sgd, limited, state
from ..render.pbr import PBR
from ..render.raster import Binned, HardSoftRas, Outline, Renderer, Softness
from ..render.schedule import Schedule
from ..render.subdivision import Subdivision, subdivide
from ..render.surface import Surface
from ..render.tone import Tone, decode_srgb, encode_srgb
from .file_scene import load_scene
from .problem import Loss, Problem
from .scene import Scene

__all__ = ["Adam", "AdamUniform", "AdamW", "Binned", "BlinnPhong", "Camera", "Channel", "Clipped", "Coordinates", "Corner",
           "Environment", "F", "HardSoftRas", "Lambert", "LargeSteps", "Light", "Loss", "Masks", "Mesh", "NormalMap", "Occlusion",
           "Optimizer", "Outline", "PBR", "Problem", "Product", "Renderer", "Scaled", "Scene", "Schedule", "Sgd", "Shadow", "Softness",
           "Subdivision", "Surface", "Texture", "Tone", "Unlit", "Vertex", "Views", "blend_shapes", "charbonnier", "check_op",
           "corner_normals", "cotangent_laplacian", "decode_srgb", "depth_loss", "edge_length", "encode_srgb", "face_points",
           "huber", "icosphere", "l1", "l2", "landmarks", "limited", "linear_mesh", "linear_model", "load_mesh", "load_panorama",
           "load_parts", "load_photographs", "load_scene", "load_views", "look_along", "look_at", "mean_square",
           "normal_consistency", "normal_loss", "octahedral", "op", "orbit", "panorama", "pear", "pyramid_l1", "rigid",
           "save_mesh", "save_parts", "save_png", "similarity", "skin", "sphere", "ssim", "ssim_loss", "state", "subdivide",
           "tint", "total_variation", "uniform_laplacian", "visual_hull"]
