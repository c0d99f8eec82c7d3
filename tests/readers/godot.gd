# Writes where Godot 3 has the joints of dance.glb every seventh frame, to dance.json beside it (see
# scripts/check-formats.sh).
extends SceneTree

const FPS = 60.0


func _init():
	var scene = load("res://dance.glb").instance()
	get_root().add_child(scene)
	var player = find(scene, "AnimationPlayer")
	var skeleton = find(scene, "Skeleton")
	player.current_animation = "Dance"
	var rows = []
	for frame in range(0, int(player.current_animation_length * FPS), 7):
		player.seek(frame / FPS, true)
		var joints = {}
		for bone in range(skeleton.get_bone_count()):
			var pose = skeleton.global_transform * skeleton.get_bone_global_pose(bone)
			joints[skeleton.get_bone_name(bone)] = [pose.origin.x, pose.origin.y, pose.origin.z]
		rows.append([frame, joints])
	var file = File.new()
	file.open("res://dance.json", File.WRITE)
	file.store_string(to_json(rows))
	file.close()
	quit()


func find(node, kind):
	if node.get_class() == kind:
		return node
	for child in node.get_children():
		var found = find(child, kind)
		if found:
			return found
	return null
