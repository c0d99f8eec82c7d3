extends SceneTree
## Asks a server for a dance and looks at what came:
##     godot --headless --path examples/godot --script check.gd -- SERVER SONG


func _initialize() -> void:
	_check.call_deferred()


func _check() -> void:
	var arguments := OS.get_cmdline_user_args()
	var bailando := Bailando.new()
	bailando.server = arguments[0]
	root.add_child(bailando)
	var song := FileAccess.get_file_as_bytes(arguments[1])
	var dancer := await bailando.dance(song, {"seed": 7, "duration_s": 4})
	if dancer == null:
		printerr(bailando.problem)
		quit(1)
		return
	root.add_child(dancer)
	var player: AnimationPlayer = dancer.find_children("*", "AnimationPlayer", true, false)[0]
	var skeleton: Skeleton3D = dancer.find_children("*", "Skeleton3D", true, false)[0]
	var length := player.get_animation(Bailando.ANIMATION).length
	player.play(Bailando.ANIMATION)
	var head := skeleton.find_bone("head")
	var path := 0.0
	var before := Vector3.ZERO
	for frame in range(1, 40):
		player.seek(frame * 0.1, true)
		var place := skeleton.get_bone_global_pose(head).origin
		path += place.distance_to(before) if frame > 1 else 0.0
		before = place
	print("%.2f s, %d bones, the head goes %.2f m" % [length, skeleton.get_bone_count(), path])
	quit(0 if absf(length - 4.0) < 0.1 and skeleton.get_bone_count() >= 24 and path > 0.2 else 1)
