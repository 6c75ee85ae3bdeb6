"""Both renderers draw what the camera model says; a machine without OpenGL gets the one that works."""

import os
import threading

import numpy as np
import pytest

from np_description.camera import CAMERA
from np_description.domains import BUMP, CARD
from np_description.keypoints import box_keypoints
from np_description.scene import CORNER_COLOURS, OBJECT
from np_sim_bridge import renderer as renderers
from np_sim_bridge.imaging import CameraThread
from np_sim_bridge.renderer import EglRenderer, WarpRenderer, egl_works, make_renderer
from np_sim_bridge.renderer_process import RendererProcess
from np_sim_bridge.simulation import Simulation

HAS_EGL = egl_works()
needs_egl = pytest.mark.skipif(not HAS_EGL, reason="OpenGL through EGL does not work on this machine")
KINDS = [pytest.param(EglRenderer, marks=needs_egl, id="egl"), pytest.param(WarpRenderer, id="warp")]


@pytest.fixture(scope="module")
def scene():
    """A cube beside the bump with the arm out of sight: (simulation, positions)."""
    simulation = Simulation(BUMP, seed=2)
    return simulation, simulation.configuration()


@pytest.fixture(scope="module")
def images(scene):
    """Renderer class -> image without shadows, made once."""
    simulation, configuration = scene
    drawn = {}
    for make in (EglRenderer, WarpRenderer) if HAS_EGL else (WarpRenderer,):
        renderer = make(simulation.model, shadows=False)
        drawn[make] = renderer.render(configuration)
        renderer.close()
    return drawn


def block_centroids(image):
    """Corner index -> pixel centroid (u, v) of its block's colour, for blocks of which enough is seen."""
    hue = image / np.maximum(image.sum(axis=2, keepdims=True), 1)
    saturated = image.max(axis=2).astype(int) - image.min(axis=2) > 60
    colours = np.array(CORNER_COLOURS) / np.sum(CORNER_COLOURS, axis=1, keepdims=True)
    nearest = np.linalg.norm(hue[:, :, None] - colours, axis=-1).argmin(axis=-1)
    found = {}
    for corner in range(len(colours)):
        v, u = np.nonzero(saturated & (nearest == corner))
        if u.size > 40:
            found[corner] = np.array([u.mean(), v.mean()])
    return found


@pytest.mark.parametrize("make", KINDS)
def test_the_object_is_drawn_where_the_camera_model_projects_it(make, scene, images):
    simulation, _ = scene
    pose = simulation.object_pose()
    corners = box_keypoints(BUMP.half_size, pose.position, pose.quaternion)
    pixels, _ = CAMERA.project(corners)
    v, u = np.nonzero(images[make].max(axis=2).astype(int) - images[make].min(axis=2) > 60)
    # The silhouette of a box is the hull of its corners: pixel centres reach it within one pixel.
    assert np.allclose([u.min(), v.min()], pixels.min(axis=0), atol=1.0)
    assert np.allclose([u.max(), v.max()], pixels.max(axis=0), atol=1.0)
    found = block_centroids(images[make])
    assert len(found) >= 4
    for corner, centroid in found.items():
        # Blocks of one colour are nearer to their own corner than to the middle of the object.
        middle = pixels.mean(axis=0)
        assert (centroid - middle) @ (pixels[corner] - middle) > 0


@needs_egl
def test_both_renderers_draw_the_same_blocks_in_the_same_places(images):
    by_egl, by_warp = block_centroids(images[EglRenderer]), block_centroids(images[WarpRenderer])
    assert by_egl.keys() == by_warp.keys() and len(by_egl) >= 4
    for corner, centroid in by_egl.items():
        assert np.linalg.norm(centroid - by_warp[corner]) < 0.7


@needs_egl
@pytest.mark.parametrize("shadows", [False, True])
def test_both_renderers_agree_on_nearly_every_pixel(scene, shadows):
    simulation, configuration = scene
    configuration = configuration.copy()
    configuration[[1, 3, 5]] = 0.3, -2.2, 2.5  # the hand in view
    drawn = []
    for make in (EglRenderer, WarpRenderer):
        renderer = make(simulation.model, shadows=shadows)
        drawn.append(renderer.render(configuration).astype(int))
        renderer.close()
    different = np.abs(drawn[0] - drawn[1]).max(axis=2) > 20
    assert different.mean() < 0.01


@pytest.mark.parametrize("make", KINDS)
def test_equal_configurations_give_equal_images(make, scene):
    simulation, configuration = scene
    moved = configuration.copy()
    moved[simulation.model.joint(OBJECT).qposadr[0]] += 0.02
    # Two at a time must not disturb each other.
    first, second = make(simulation.model), make(simulation.model)
    image = first.render(configuration)
    assert image.shape == (CAMERA.height, CAMERA.width, 3) and image.dtype == np.uint8
    assert (second.render(moved) != image).any()
    second.close()
    assert (first.render(configuration) == image).all()
    first.close()


@pytest.mark.parametrize("make", KINDS)
def test_the_arm_casts_a_shadow_when_asked_to(make, scene):
    simulation, configuration = scene
    drawn = []
    for shadows in (False, True):
        renderer = make(simulation.model, shadows=shadows)
        drawn.append(renderer.render(configuration).astype(int))
        renderer.close()
    darker = (drawn[0] - drawn[1]).max(axis=2) > 20
    assert darker.sum() > 50
    assert ((drawn[1] - drawn[0]).max(axis=2) > 20).sum() == 0


def test_a_driver_that_aborts_its_process_means_the_ray_caster(monkeypatch):
    monkeypatch.setattr(renderers, "_PROBE", "import os; os.abort()")
    assert isinstance(make_renderer("auto", Simulation(CARD).model), WarpRenderer)


@pytest.mark.parametrize(
    "variable, value", [("PYOPENGL_PLATFORM", "osmesa"), ("__EGL_VENDOR_LIBRARY_DIRS", os.devnull)]
)
def test_without_a_usable_egl_the_ray_caster_draws(monkeypatch, variable, value):
    """OpenGL taken by another platform; a loader that finds no driver."""
    monkeypatch.setenv(variable, value)
    assert isinstance(make_renderer("auto", Simulation(CARD).model), WarpRenderer)


def test_an_unknown_renderer_is_refused():
    with pytest.raises(ValueError, match="expected one of auto, egl, warp"):
        make_renderer("vulkan", Simulation(CARD).model)


class Slow:
    """A renderer that finishes an image only when told to."""

    def __init__(self):
        self.go = threading.Semaphore(0)

    def render(self, configuration):
        self.go.acquire()
        if configuration is None:
            raise RuntimeError("no picture")
        return np.full((1, 1, 3), configuration, np.uint8)

    def close(self):
        pass


def test_the_camera_thread_drops_what_it_cannot_draw_in_time():
    slow, delivered, done = Slow(), [], threading.Event()

    def deliver(stamp, pixels):
        delivered.append((stamp, int(pixels[0, 0, 0])))
        done.set()

    camera = CameraThread(lambda: slow, deliver)
    taken = sum(camera.submit(stamp, stamp, wait=False) for stamp in range(5))
    assert 1 <= taken <= 2
    for _ in range(5):
        slow.go.release()
    assert done.wait(10)
    assert camera.submit(7, 7, wait=True)
    camera.close()
    assert delivered[0] == (0, 0) and delivered[-1] == (7, 7)


def test_an_error_while_drawing_reaches_the_node():
    slow = Slow()
    slow.go.release()
    camera = CameraThread(lambda: slow, lambda stamp, pixels: None)
    camera.submit(0, None, wait=True)
    camera._thread.join(10)
    with pytest.raises(RuntimeError, match="no picture"):
        camera.submit(1, 1, wait=True)
    camera.close()


def test_an_error_while_building_the_renderer_reaches_the_node():
    def broken():
        raise OSError("no renderer")

    with pytest.raises(OSError, match="no renderer"):
        CameraThread(broken, lambda stamp, pixels: None)


def test_a_process_of_its_own_draws_the_same_pixels(scene):
    simulation, configuration = scene
    kind = "egl" if HAS_EGL else "warp"
    here, there = make_renderer(kind, simulation.model), RendererProcess(kind, simulation.model)
    try:
        for shift in (0.0, 0.1):
            moved = configuration.copy()
            moved[9] += shift
            assert np.array_equal(here.render(moved), there.render(moved))
    finally:
        here.close()
        there.close()
    assert there._child.returncode is not None


def test_a_renderer_process_that_cannot_draw_says_why(scene):
    with pytest.raises(RuntimeError, match="renderer: expected one of auto, egl, warp, got 'crayon'"):
        RendererProcess("crayon", scene[0].model)


def test_a_killed_renderer_process_is_an_error_not_a_hang(scene):
    simulation, configuration = scene
    renderer = RendererProcess("egl" if HAS_EGL else "warp", simulation.model)
    renderer._child.kill()
    renderer._child.wait()
    with pytest.raises(RuntimeError, match="renderer process: expected an image, it ended"):
        renderer.render(configuration)
    renderer.close()
