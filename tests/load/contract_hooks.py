"""What schemathesis is told about this API: half of all songs are songs, half of all ids are jobs.

Left alone it draws bytes that are no audio and ids of no job, and sees refusals only.
"""

import os
import sys
from pathlib import Path

import schemathesis
from hypothesis import strategies

sys.path.insert(0, str(Path(__file__).parent))

from songs import long_wav, mp3  # noqa: E402

SONGS = [long_wav(1), mp3(2), long_wav(0.6)]
# Ids of jobs that are there, done and failed.
JOBS = os.environ.get("CONTRACT_JOBS", "").split()

songs_or_not = strategies.sampled_from(SONGS) | strategies.binary(max_size=2000)
for kind in ("audio/*", "application/octet-stream"):
    schemathesis.openapi.media_type(kind, songs_or_not)


# Schemas of a job's events; those of a dance end with "Event".
JOB_EVENTS = ["JobStatus"]
JOB_KINDS = ["progress", "done", "failed"]


def one_event(names, kinds):
    """The schema of a server-sent event whose data are an object of one of these schemas."""
    objects = [{"$ref": f"#/components/schemas/{name}"} for name in names]
    data = {
        "type": "string",
        "contentMediaType": "application/json",
        "contentSchema": {"anyOf": objects},
    }
    return {
        "type": "object",
        "required": ["event", "data"],
        "properties": {"event": {"enum": kinds}, "data": data},
    }


@schemathesis.hook
def before_load_schema(context, raw_schema):
    """Says in OpenAPI 3.2's words what ours, 3.1, can only say in prose: what the events of a stream are.

    Otherwise the tool takes the schema of the whole stream, which is text, for that of an event.
    """
    schemas = raw_schema["components"]["schemas"]
    # The tool cannot leave out or damage one of two binary fields; a BVH file is text anyway.
    del schemas["GenerateForm"]["properties"]["rig"]["format"]
    dance = one_event(
        [name for name in schemas if name.endswith("Event")], ["start", "frames", "done", "error"]
    )
    job = one_event(JOB_EVENTS, JOB_KINDS)
    for path, route in raw_schema["paths"].items():
        for operation in route.values():
            for response in operation["responses"].values():
                stream = response.get("content", {}).get("text/event-stream")
                if stream and stream.get("schema") == {"type": "string"}:
                    del stream["schema"]
                    stream["itemSchema"] = job if path.startswith("/jobs/") else dance


@schemathesis.hook
def map_body(context, body):
    """A form's song, where there is one; most forms go without a character."""
    if isinstance(body, dict) and isinstance(body.get("file"), (bytes, str)):
        number = len(body["file"]) + len(body)
        if number % 4:
            body["file"] = SONGS[number % len(SONGS)]
            body.pop("rig", None)
    return body


@schemathesis.hook
def map_path_parameters(context, parameters):
    # Deleted ones would be missed by those that ask.
    if parameters and "id" in parameters and JOBS and context.operation.method.lower() == "get":
        number = len(str(parameters["id"]))
        if number % 2:
            parameters["id"] = JOBS[number // 2 % len(JOBS)]
    return parameters
