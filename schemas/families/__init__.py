"""The open families: kinds of objects of which there may be more. Each is one tuple, the names of its members, in a module here.

Nothing else lists them. What a member is, one frozen object says, in the module of the member's name: `SCANNET` in
`tasks.capture.scannet` is the scan format `scannet`. `tasks.families.members` makes the tuple of objects of the tuple of names.

The names lie here because rows hold them, and because a command can offer a choice of them without loading what they name. Each family
has a module of its own, which imports nothing: a further member makes no rows stale but those of the stage that has it.
"""
