"""`view`: look at a scene in the browser."""

from stylesplat.argument_kinds import check_arguments
from stylesplat.figures.browser import serve_viewer
from stylesplat.figures.private_server import PrivateServer
from stylesplat.scene.scene import Scene
from stylesplat.scene.splats import Splats


@check_arguments
def view(what: Scene | Splats, *, port: int = 8080, block: bool = True) -> PrivateServer:
    """Show a scene in a browser: in mean colours, and as it is as soon as the camera rests.

    Args:
        what: A scene, or splats alone, of which nobody knows what is up.
        port: Port on 127.0.0.1, or the next free one.
        block: Serve until Ctrl-C; otherwise return at once.

    Returns:
        The running server; its `url` opens it, `stop()` ends it.

    Raises:
        StyleSplatError: If viser is not installed or there is nothing to show.
    """
    if isinstance(what, Splats):
        return serve_viewer(what, port=port, block=block)
    return serve_viewer(what.splats, cameras=what.cameras, port=port, block=block)
