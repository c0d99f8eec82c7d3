class_name Bailando
extends Node
## A client of a bailando server: a song in, a scene with skeleton, mesh and animation out.

const ANIMATION := "Dance"

@export var server := "http://127.0.0.1:8080"
@export var key := ""
## What was wrong, in the server's words, where [method dance] returned null.
var problem := ""


## Returns the dance to a song as a scene that is not yet in the tree, or null.
## Options are those of the server, such as "seed" or "duration_s".
func dance(song: PackedByteArray, options: Dictionary = {}) -> Node3D:
	var glb := await _post("/generate", song, options.merged({"format": "glb"}, true))
	if glb.is_empty():
		return null
	var state := GLTFState.new()
	var document := GLTFDocument.new()
	var result := document.append_from_buffer(glb, "", state)
	if result != OK:
		problem = "the GLB cannot be read: %s" % error_string(result)
		return null
	return document.generate_scene(state)


func _post(path: String, body: PackedByteArray, options: Dictionary) -> PackedByteArray:
	problem = ""
	var request := HTTPRequest.new()
	add_child(request)
	var query := HTTPClient.new().query_string_from_dict(options)
	var headers := PackedStringArray(["content-type: audio/*"])
	if key != "":
		headers.append("authorization: Bearer " + key)
	var url := "%s%s?%s" % [server, path, query]
	var sent := request.request_raw(url, headers, HTTPClient.METHOD_POST, body)
	if sent != OK:
		request.queue_free()
		problem = "the server cannot be asked: %s" % error_string(sent)
		return PackedByteArray()
	var answer: Array = await request.request_completed
	request.queue_free()
	if answer[0] != HTTPRequest.RESULT_SUCCESS:
		problem = "no answer from %s" % server
		return PackedByteArray()
	if answer[1] != 200:
		var refusal: Variant = JSON.parse_string(answer[3].get_string_from_utf8())
		problem = refusal["error"] if refusal is Dictionary else "status %d" % answer[1]
		return PackedByteArray()
	return answer[3]
