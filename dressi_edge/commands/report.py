"""`report` and `view`: a page of a bundle, or of a mesh file, as one HTML file."""
from __future__ import annotations

import os
import tempfile

from ..cache import bundle as bundles
from ..cache.errors import DeviceError, InputError
from .files import check_folder, write_file
from .keep import resume
from .progress import Events, Terminal
from .run import open_session


def report(args) -> None:
    """The command: what a bundle is made of and shows, from its start or from a checkpoint."""
    path = args.output or os.path.splitext(args.bundle)[0] + ".html"
    _check_page(path)
    if args.checkpoint and not os.path.exists(args.checkpoint):
        raise InputError(f"--checkpoint {args.checkpoint}: there is no such file")
    from ..page.html import page
    with Events(Terminal()) as events:
        events.doing(f"loading {args.bundle}")
        data, model = _report_data(args, events)
        events.doing(f"writing {path}")
        write_file(path, page(data, model))
    print(f"{path}: {os.path.getsize(path) / 1e6:.1f} MB")


def _report_data(args, events: Events) -> tuple[dict, bytes | None]:
    from ..page import result
    title = os.path.basename(args.bundle)
    try:
        session = open_session(args)
    except DeviceError as error:
        if args.checkpoint:
            raise
        from ..page.facts import bundle_facts, versions
        found = bundles.read(args.bundle, args.pin).variants[0]
        return {"title": title, "subtitle": f"without a device: {error}", "bundle": bundle_facts(found), "versions": versions()}, None
    with session:
        session.ready()
        before = result.results.snapshot(session, result.SHOWN) if args.checkpoint else None
        todo = [(name, session.plans[name]["steps"] or 0) for name in session.phases]
        courses = resume(session, args.checkpoint, todo, strict=False) if args.checkpoint else {}
        events.doing("drawing")
        data = result.run_data(session, title, [c for c in courses.values() if c.done or c.curve], before, times=not args.no_times)
        return data, result.model(session)


def view(args) -> None:
    """The command: a mesh file in a browser."""
    from ..page.html import page
    from ..page.result import file_model
    title = os.path.basename(args.mesh)
    if args.output:
        _check_page(args.output)
    data = page({"title": title}, file_model(args.mesh))
    path = args.output or os.path.join(tempfile.mkdtemp(prefix="dressi-"), os.path.splitext(title)[0] + ".html")
    write_file(path, data)
    print(f"{path}: {len(data) / 1e6:.1f} MB")
    if not args.output:
        import pathlib
        import webbrowser
        if not webbrowser.open(pathlib.Path(path).as_uri()):
            print("no browser was found; open it in one")


def _check_page(path: str) -> None:
    if not path.lower().endswith((".html", ".htm")):
        raise InputError(f"output {path}: a page is written; name it .html")
    check_folder(path)
