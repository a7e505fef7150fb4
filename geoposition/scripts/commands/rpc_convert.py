"""`geoposition rpc convert`: one dialect of RPC file to another."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def command(
    rpc: Annotated[Path, typer.Argument(help="RPC file of any dialect, or image carrying one.")],
    output: Annotated[
        Path,
        typer.Option("-o", "--output", help=".RPB, _RPC.TXT, .XML (DIMAP), .geom, .json or .tif."),
    ],
    json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
) -> None:
    """Rewrite an RPC in the dialect that the output's name asks for.

    Example: geoposition rpc convert RPC_PHR1A.XML -o image_RPC.TXT
    """
    from geoposition.rpc.formats import read_rpc, sniff, write_rpc
    from geoposition.scripts.results import print_facts, print_json
    from geoposition.scripts.tables import check_output

    check_output(output)
    dialect = sniff(rpc)
    write_rpc(read_rpc(rpc), output)
    result = {"input": str(rpc), "from": dialect, "to": sniff(output), "output": str(output)}
    if json:
        print_json(result)
    else:
        print_facts(str(output), result)
