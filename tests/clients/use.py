"""Uses the client that openapi-python-client makes: JSON, BVH and a job.

usage: use.py ADDRESS SONG, with the folder of the client `bailando_client` in PYTHONPATH
"""

import sys
import time
from io import BytesIO
from pathlib import Path

from bailando_client import AuthenticatedClient
from bailando_client.api.dance import generate_file, generate_motion
from bailando_client.api.jobs import create_job, delete_job, get_job, get_job_result
from bailando_client.models import (
    Dance,
    GenerateFileFormat,
    GenerateForm,
    GenerateFormFps,
    JobStatus,
)
from bailando_client.types import File


def main(address: str, song: Path) -> None:
    # A server without keys takes any.
    client = AuthenticatedClient(base_url=address, token="none")

    def form() -> GenerateForm:
        file = File(payload=BytesIO(song.read_bytes()), file_name=song.name)
        return GenerateForm(file=file, seed=7, duration_s=3.0, fps=GenerateFormFps.VALUE_30)

    dance = generate_motion.sync(client=client, body=form())
    assert isinstance(dance, Dance), dance
    assert (dance.seed, dance.fps, dance.frames) == (7, 30, 90), dance.to_dict()

    # As the body itself, with options in the query.
    raw = File(payload=BytesIO(song.read_bytes()))
    again = generate_motion.sync(client=client, body=raw, seed=7, duration_s=3.0)
    assert isinstance(again, Dance) and again.frames == 180

    bvh = generate_file.sync_detailed(client=client, body=form(), format_=GenerateFileFormat.BVH)
    assert bvh.content.startswith(b"HIERARCHY"), bvh

    job = create_job.sync(client=client, body=form())
    assert isinstance(job, JobStatus), job
    for _ in range(600):
        state = get_job.sync(job.id, client=client)
        assert isinstance(state, JobStatus), state
        if state.result:
            break
        time.sleep(0.1)
    result = get_job_result.sync(job.id, client=client)
    assert isinstance(result, Dance) and result.frames == 90, result
    delete_job.sync_detailed(job.id, client=client)
    print("openapi-python-client: JSON, BVH and a job")


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
