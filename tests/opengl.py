"""Whether this machine can draw."""

import pytest

from lpvmpc.errors import RenderError
from lpvmpc.picture.video.stage import gl_context


def has_opengl():
    try:
        context = gl_context(16, 16)
    except RenderError:
        return False
    context.free()
    return True


needs_opengl = pytest.mark.skipif(not has_opengl(), reason="no OpenGL on this machine")
