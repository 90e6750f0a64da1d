"""Mutated mesh files are read, or refused in one line: a thousand in every run, a hundred thousand in the full one."""

import warnings

import pytest
from fuzz_meshes import corpus, run

from dressi_edge.compiler.io.meshes import load_mesh, load_parts


def test_the_files_that_are_mutated_are_read(tmp_path):
    files = corpus(tmp_path)
    assert {path.suffix for path in files} == {".obj", ".mtl", ".off", ".ply", ".stl", ".glb", ".gltf"}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert all(len(load_mesh(path).faces) > 0 and load_parts(path) for path in files if path.suffix != ".mtl")


def test_mutated_files_give_a_mesh_or_one_line():
    assert run(1000, 1) == []


@pytest.mark.full
def test_a_hundred_thousand_mutations():
    assert run(100_000, 3) == []
