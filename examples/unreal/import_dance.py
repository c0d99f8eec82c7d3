"""For the Python console of Unreal Editor 5.3 or newer (plug-in "Python Editor Script Plugin"): asks a
bailando server for a dancer on Unreal's own bone names and imports mesh, skeleton and animation.

    py import_dance.py C:/songs/song.mp3 http://127.0.0.1:8080

Outside the editor it only fetches the file.
"""

import pathlib
import sys
import tempfile
import urllib.parse
import urllib.request

FOLDER = "/Game/Dances"


def fetch(song: pathlib.Path, server: str, **options) -> pathlib.Path:
    """Writes the dance to a temporary GLB: with the doll, since an IK Rig needs a skeletal mesh."""
    query = urllib.parse.urlencode({"format": "glb", "skeleton": "unreal", "fps": 30, **options})
    request = urllib.request.Request(
        f"{server}/generate?{query}", data=song.read_bytes(), headers={"content-type": "audio/*"}
    )
    out = pathlib.Path(tempfile.mkdtemp()) / f"{song.stem}.glb"
    with urllib.request.urlopen(request) as answer:
        out.write_bytes(answer.read())
    return out


def import_glb(unreal, file: pathlib.Path) -> list:
    """Imports with the settings that the editor has for glTF."""
    task = unreal.AssetImportTask()
    task.filename = str(file)
    task.destination_path = FOLDER
    task.automated = True
    task.save = True
    unreal.AssetToolsHelpers.get_asset_tools().import_asset_tasks([task])
    return list(task.imported_object_paths)


if __name__ == "__main__":
    dance = fetch(pathlib.Path(sys.argv[1]), (sys.argv[2:] or ["http://127.0.0.1:8080"])[0])
    try:
        import unreal
    except ImportError:
        print(f"{dance}: this is no Unreal Editor, so import it there")
    else:
        print(import_glb(unreal, dance))
