"""Losses and regularizers: graph in, a float of extent 1x1 out. Means count every texel or entry of the extent and no padding."""
from .image import (
    charbonnier,
    depth_loss,
    huber,
    l1,
    l2,
    mean_square,
    normal_loss,
    pyramid_l1,
    ssim,
    ssim_loss,
    tint,
    total_variation,
)
from .mesh import COTANGENTS, cotangent_laplacian, edge_length, normal_consistency, uniform_laplacian
from .points import face_points, landmarks

__all__ = ["COTANGENTS", "charbonnier", "cotangent_laplacian", "depth_loss", "edge_length", "face_points", "huber", "l1", "l2", "landmarks",
           "mean_square", "normal_consistency", "normal_loss", "pyramid_l1", "ssim", "ssim_loss", "tint",
           "total_variation", "uniform_laplacian"]
