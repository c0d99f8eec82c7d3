extends Node3D
## Dances to a song: Godot 4.2 or newer, a bailando server on this machine.
##     godot --path examples/godot -- song.mp3

var _animation: AnimationPlayer
var _sound: AudioStreamPlayer


func _ready() -> void:
	var arguments := OS.get_cmdline_user_args()
	var path := arguments[0] if arguments.size() > 0 else "song.mp3"
	var song := FileAccess.get_file_as_bytes(path)
	var bailando := Bailando.new()
	add_child(bailando)
	var dancer := await bailando.dance(song, {"seed": 7})
	if dancer == null:
		push_error(bailando.problem)
		return
	add_child(dancer)
	_animation = dancer.find_children("*", "AnimationPlayer", true, false)[0]
	_animation.play(Bailando.ANIMATION)
	_animation.pause()
	var stream := AudioStreamMP3.new()
	stream.data = song
	_sound = AudioStreamPlayer.new()
	_sound.stream = stream
	add_child(_sound)
	_sound.play()


func _process(_delta: float) -> void:
	if _sound == null or not _sound.playing:
		return
	# The sound leads: where it is now, between the mixer's chunks and less the way to the speaker.
	var now := _sound.get_playback_position() + AudioServer.get_time_since_last_mix()
	_animation.seek(maxf(0.0, now - AudioServer.get_output_latency()), true)
