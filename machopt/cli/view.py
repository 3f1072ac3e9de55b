"""The command ``view``: a plan in a browser on this machine, to look at and to steer."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from machopt.cli.compiling import compiling
from machopt.cli.display import Display, port
from machopt.cli.effects import told_of_effects
from machopt.cli.readingoptions import reading, reading_parser
from machopt.cli.shared import share

Commands = Any  # argparse keeps its subparsers' type private


def add_commands(commands: Commands, common: argparse.ArgumentParser) -> None:
    """Add the command to the parser."""
    p = commands.add_parser(
        "view",
        parents=[common, reading_parser()],
        help="3-D review and re-planning in a browser on this machine: pin, forbid, prefer, choose branches",
    )
    p.add_argument(
        "places",
        type=Path,
        nargs="+",
        metavar="OUT | CELL [TOOLPATH]",
        help="an output folder of optimize (its cell and toolpath are found by their hashes, or given behind it), or a "
        "cell to look at; with a toolpath it is planned and can be steered",
    )
    share(p, "--plan")
    share(p, "--set")
    share(p, "--seed", default=None, help="of the random search around obstacles")
    share(p, "--allow-external")
    p.add_argument("--port", type=port, default=0, help="of 127.0.0.1 (any that is free)")
    p.add_argument(
        "--save", type=Path, default=Path("plan.yaml"), metavar="FILE", help="where the page saves the plan (plan.yaml)"
    )
    share(p, "--force")
    p.add_argument("--open", action="store_true", help="open the page in the browser of the system")
    p.add_argument("--as-it-is", action="store_true", help="of OUT: show the report, plan nothing")
    share(p, "--effects")
    p.set_defaults(run=_view)


def _view(args: argparse.Namespace) -> int:
    from machopt.effects.own import in_use, with_effects
    from machopt.services.load import OptimizeRequest
    from machopt.view.run import Asked, serve

    request = OptimizeRequest(
        cell=args.places[0],
        toolpath=args.places[-1],
        out=Path("steered"),
        overwrite=args.overwrite,
        plan_file=args.plan,
        overrides=(*args.set, *(() if args.seed is None else (f"seed={args.seed}",))),
        reading=reading(args),
        allow_external=args.allow_external,
        effects=tuple(args.effects),
    )
    asked = Asked(
        places=tuple(args.places),
        request=request,
        save=args.save,
        words=_words(args),
        port=args.port,
        as_it_is=args.as_it_is,
    )
    told_of_effects(args)
    with in_use(with_effects(request.effects)):
        show = not (args.quiet or args.json)
        with Display(show=show) as display, compiling(display):
            server = serve(asked, lambda text: None if args.quiet else print(f"machopt: {text}"), display.stage)
        try:
            print(server.url, flush=True)
            if not args.quiet:
                print("machopt: for this machine alone; Ctrl-C ends it", file=sys.stderr)
            if args.open:
                import webbrowser

                webbrowser.open(server.url)
            server.work()
        except KeyboardInterrupt:
            pass  # asked for
        finally:
            server.close()
    return 0


def _words(args: argparse.Namespace) -> tuple[str, ...]:
    """The reading options as they were given, for the command that plans the same."""
    out: list[str] = []
    for name in ("unit", "machine", "feed", "tool_axis", "decimals", "cycle_order", "max_extent", "kind"):
        value = getattr(args, name)
        if value is not None:
            out.append(f"--{name.replace('_', '-')}={value}")
    for value in args.offset:
        out.append(f"--offset={value}")
    for value in args.accept_unknown:
        out.append(f"--accept-unknown={value}")
    for value in args.effects:
        out.append(f"--effects={value}")
    return (*out, *(["--strict"] if args.strict else []), *(["--allow-external"] if args.allow_external else []))
