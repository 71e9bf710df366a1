//! Broken scene files: which are rejected, with which message, and that no text makes the parser panic.

use std::path::PathBuf;

use meldscope::{Scene, SceneError};
use proptest::prelude::*;

use crate::scene_format::{REFERENCES, assert_valid};

/// Broken files and the expected messages. A block is `PART: what is wrong`, lines of the file, `> message`.
///
/// `Whole` is the complete file. For the other parts, the lines are inserted into an otherwise valid file: at its top
/// (from line 1), or directly below the header of that part (from line 3, or line 7 for `Push`).
const BROKEN: &str = r##"
Whole: only a comment
# nothing here
> bad.toml:1:1: body: missing, expected at least one [[body]]

Whole: not TOML: a word
duration = fast
> bad.toml:1:12: duration: not valid TOML: invalid boolean, expected `false`, found "fast"

Whole: not TOML: no value
duration =
> bad.toml:1:11: duration: not valid TOML: string values must be quoted, expected literal string

Whole: not TOML: a key twice
duration = 4
duration = 5
> bad.toml:2:1: duration: not valid TOML: duplicate key, found "duration"

Whole: not TOML: a table twice
duration = 4
[influence]
[material]
[influence]
> bad.toml:4:2: not valid TOML: duplicate key, found "influence"

Whole: not TOML: a header without end
[material
omega = 1
> bad.toml:1:10: not valid TOML: unclosed table, expected `]`

Whole: not TOML: a string without end
name = "two
duration = 4
> bad.toml:1:12: name: not valid TOML: invalid basic string, expected `"`

Whole: not TOML: an array without end
duration = 4
[[body]]
motion = { fixed = [0, 0, 0
> bad.toml:3:28: motion: not valid TOML: unclosed array, expected `]`

Whole: not TOML: a bad number
duration = 4.0.0
> bad.toml:1:15: duration: not valid TOML: invalid float, found ".0"

Whole: not TOML: a bad escape
name = "C:\two"
> bad.toml:1:1: body: missing, expected at least one [[body]]

Whole: not TOML: a C comment
duration = 4 // s
> bad.toml:1:12: duration: not valid TOML: string values must be quoted, expected literal string, found "4 // s"

Whole: no body
duration = 4
> bad.toml:1:1: body: missing, expected at least one [[body]]

Whole: no duration
[[body]]
name = "a"
radius = 1
motion = { fixed = [0, 0, 0] }
> bad.toml:1:1: duration: missing, expected a number between 1e-12 and 1e15

Whole: columns after characters of several bytes
name = "größe"
x = { "ä" = "ö" } # ü
> bad.toml:2:1: x: unknown key (known keys: name, dt, duration, integrator, tolerance, gravity, model, material, influence, lattice, fem, surface, mesh, body, grid, pair, plane, point, push, edit)

Whole: body is a single table
duration = 4
[body]
name = "a"
> bad.toml:2:1: body: expected an array of tables, each written [[body]], found a table

Whole: body is empty
duration = 4
body = []
> bad.toml:2:8: body: expected at least one [[body]], found an empty array

Whole: body is a number
duration = 4
body = 2
> bad.toml:2:8: body: expected an array of tables, each written [[body]], found 2

Whole: bodies are numbers
duration = 4
body = [1, 2]
> bad.toml:2:9: body[0]: expected a table, written [[body]], found 1

Whole: body without a name
duration = 4
[[body]]
radius = 1
motion = { fixed = [0, 0, 0] }
> bad.toml:2:1: body[0].name: missing, expected a name of 1 to 64 letters, digits, - and _

Whole: body without a radius
duration = 4
[[body]]
name = "a"
motion = { fixed = [0, 0, 0] }
> bad.toml:2:1: body["a"].radius: missing, expected a number between 1e-12 and 1e15

Whole: body without a motion
duration = 4
[[body]]
name = "a"
radius = 1
> bad.toml:2:1: body["a"].motion: missing, expected a table such as { fixed = [0, 0, 0] }

Whole: two bodies of one name
duration = 4
[[body]]
name = "a"
radius = 1
motion = { fixed = [0, 0, 0] }
[[body]]
name = "a"
radius = 2
motion = { fixed = [3, 0, 0] }
> bad.toml:7:8: body["a"].name: expected a name that no other body has (the body at line 3 has this one), found the string "a"

Whole: second body wrong
duration = 4
[[body]]
name = "a"
radius = 1
motion = { fixed = [0, 0, 0] }
[[body]]
name = "b"
radius = 0
motion = { fixed = [3, 0, 0] }
> bad.toml:8:10: body["b"].radius: expected a number between 1e-12 and 1e15, found 0

Whole: push is a single table
duration = 4
[[body]]
name = "a"
radius = 1
motion = { fixed = [0, 0, 0] }
[push]
body = "a"
> bad.toml:6:1: push: expected an array of tables, each written [[push]], found a table

Whole: push without anything
duration = 4
[[body]]
name = "a"
radius = 1
motion = { fixed = [0, 0, 0] }
[[push]]
> bad.toml:6:1: push[0].body: missing, expected the name of a body

Whole: push without a direction
duration = 4
[[body]]
name = "a"
radius = 1
motion = { fixed = [0, 0, 0] }
[[push]]
body = "a"
> bad.toml:6:1: push[0].direction: missing, expected an array of 3 numbers [x, y, z]

Whole: point without anything
duration = 4
[[body]]
name = "a"
radius = 1
motion = { fixed = [0, 0, 0] }
[[point]]
> bad.toml:6:1: point[0].name: missing, expected a name of 1 to 64 letters, digits, - and _

Point: a free point
motion = { free = { from = [0, 0, 0] } }
> bad.toml:7:19: point["hand"].motion.free: expected a path: fixed, line, sine or keyframes; found free; nothing acts on a force point, so it cannot move by itself

Point: what it does
act = "pull"
> bad.toml:7:7: point["hand"].act: expected one of "attract", "repel", found the string "pull"

Point: the strength of the other kind
beta = 3
> bad.toml:7:8: point["hand"].beta: unexpected: this point attracts, and its strength is alpha; write alpha, or change act

Point: a negative strength
alpha = -3
> bad.toml:7:9: point["hand"].alpha: expected a number between 0 and 1e15, found -3

Point: bodies that are none
bodies = []
> bad.toml:7:10: point["hand"].bodies: expected an array of one or more names of bodies or groups, found an empty array

Point: an unknown body
bodies = ["bal"]
> bad.toml:7:11: point["hand"].bodies[0]: expected the name of a body or a group, found the string "bal"; did you mean "ball"? (bodies: ball)

Point: a start before the start
start = -1
> bad.toml:7:9: point["hand"].start: expected a number between 0 and 1e15, found -1

Point: an unknown key
mass = 2
> bad.toml:7:1: point["hand"].mass: unknown key; "mass" belongs in a [[body]] or in a [[grid]] (known keys: name, motion, radius, act, bodies, start, duration, alpha, beta)

Edit: nothing set
set = {}
> bad.toml:7:7: edit[0].set: expected a table of keys and values such as { "influence.merge_at" = 1.1 }, found an empty one

Edit: no time
set = { "influence.alpha" = 1 }
time = -1
> bad.toml:8:8: edit[0].time: expected a number between 0 and 1e15, found -1

Edit: what makes the bodies
set = { "body.ball.radius" = 2 }
> bad.toml:7:30: edit[0].set."body.ball.radius": expected a number of body: omega, damping, reach; found body.ball.radius; an edit changes no shape, mass, motion, push, dt, duration or tolerance

Edit: the clock
set = { dt = 0.1 }
> bad.toml:7:14: edit[0].set.dt: expected a number of influence, material, gravity, or a body, grid, pair, plane or point; found dt; an edit changes no shape, mass, motion, push, dt, duration or tolerance

Edit: a word
set = { "influence.alpha" = "strong" }
> bad.toml:7:29: edit[0].set."influence.alpha": expected a number, found the string "strong"

Edit: out of range
set = { "influence.alpha" = -2 }
> bad.toml:7:29: edit[0].set."influence.alpha": expected a number between 0 and 1e15, found -2 (influence.alpha after this edit)

Edit: thresholds that contradict each other
set = { "influence.merge_at" = 1.3 }
> bad.toml:7:32: edit[0].set."influence.merge_at": expected a number of at most split_at (1.15 by default), found 1.3 (influence.merge_at after this edit); give split_at, too

Edit: a misspelled key
set = { "influence.merge_att" = 1.1 }
> bad.toml:7:33: edit[0].set."influence.merge_att": expected a number of influence: alpha, beta, reach, merge_at, split_at, core_at, core_width; found influence.merge_att; did you mean "merge_at"?; an edit changes no shape, mass, motion, push, dt, duration or tolerance

Edit: a misspelled table
set = { "bdy.ball.omega" = 3 }
> bad.toml:7:28: edit[0].set."bdy.ball.omega": expected a number of influence, material, gravity, or a body, grid, pair, plane or point; found bdy.ball.omega; did you mean "body"?; an edit changes no shape, mass, motion, push, dt, duration or tolerance

Edit: nobody
set = { "body.bal.omega" = 3 }
> bad.toml:7:28: edit[0].set."body.bal.omega": there is nothing named "bal"; did you mean "ball"? (names: ball)

Whole: two points of one name
duration = 4
[[body]]
name = "a"
radius = 1
motion = { fixed = [0, 0, 0] }
[[point]]
name = "p"
radius = 1
act = "repel"
motion = { fixed = [0, 0, 0] }
[[point]]
name = "p"
radius = 1
act = "repel"
motion = { fixed = [0, 0, 0] }
> bad.toml:12:8: point["p"].name: expected a name that no other point has (the point at line 7 has this one), found the string "p"

Whole: material is a number
material = 3
duration = 4
[[body]]
name = "a"
> bad.toml:1:12: material: expected a table, written [material], found 3

Whole: duration below a header
[material]
omega = 12
duration = 4
[[body]]
name = "a"
radius = 1
motion = { fixed = [0, 0, 0] }
> bad.toml:3:1: material.duration: unknown key; "duration" belongs at the top of the file or in a [[point]] or in a [[push]] (known keys: omega, damping, response)

Whole: the first of several unknown keys
zeta = 1
duration = 4
again = 2
> bad.toml:1:1: zeta: unknown key (known keys: name, dt, duration, integrator, tolerance, gravity, model, material, influence, lattice, fem, surface, mesh, body, grid, pair, plane, point, push, edit)

Top: unknown key
colour = 1
> bad.toml:1:1: colour: unknown key (known keys: name, dt, duration, integrator, tolerance, gravity, model, material, influence, lattice, fem, surface, mesh, body, grid, pair, plane, point, push, edit)

Top: unknown key near another
Integrator = "rk4"
> bad.toml:1:1: Integrator: unknown key; did you mean "integrator"? (known keys: name, dt, duration, integrator, tolerance, gravity, model, material, influence, lattice, fem, surface, mesh, body, grid, pair, plane, point, push, edit)

Top: unknown key abbreviated
integ = "rk4"
> bad.toml:1:1: integ: unknown key; did you mean "integrator"? (known keys: name, dt, duration, integrator, tolerance, gravity, model, material, influence, lattice, fem, surface, mesh, body, grid, pair, plane, point, push, edit)

Top: unknown key without letters
"" = 1
> bad.toml:1:1: "": unknown key (known keys: name, dt, duration, integrator, tolerance, gravity, model, material, influence, lattice, fem, surface, mesh, body, grid, pair, plane, point, push, edit)

Top: unknown key that is long
aaaaaaaaaabbbbbbbbbbccccccccccddddddddddeeeeeeeeee = 1
> bad.toml:1:1: aaaaaaaaaabbbbbbbbbbccccccccccdddddddddd…: unknown key (known keys: name, dt, duration, integrator, tolerance, gravity, model, material, influence, lattice, fem, surface, mesh, body, grid, pair, plane, point, push, edit)

Top: key of another table
alpha = 100
> bad.toml:1:1: alpha: unknown key; "alpha" belongs in [influence] or in a [[pair]] or in a [[point]] (known keys: name, dt, duration, integrator, tolerance, gravity, model, material, influence, lattice, fem, surface, mesh, body, grid, pair, plane, point, push, edit)

Top: key of several tables
response = "rigid"
> bad.toml:1:1: response: unknown key; "response" belongs in [material] or in a [[body]] or in a [[grid]] (known keys: name, dt, duration, integrator, tolerance, gravity, model, material, influence, lattice, fem, surface, mesh, body, grid, pair, plane, point, push, edit)

Top: unknown table
matrial.omega = 1
> bad.toml:1:1: matrial: unknown key; did you mean "material"? (known keys: name, dt, duration, integrator, tolerance, gravity, model, material, influence, lattice, fem, surface, mesh, body, grid, pair, plane, point, push, edit)

Top: name is a number
name = 2
> bad.toml:1:8: name: expected a name of 1 to 200 characters on one line, found 2

Top: name is empty
name = ""
> bad.toml:1:8: name: expected a name of 1 to 200 characters on one line, found the string ""

Top: dt zero
dt = 0
> bad.toml:1:6: dt: expected a number between 1e-12 and 1e15, found 0

Top: dt negative
dt = -0.01
> bad.toml:1:6: dt: expected a number between 1e-12 and 1e15, found -0.01

Top: dt tiny
dt = 1e-13
> bad.toml:1:6: dt: expected a number between 1e-12 and 1e15, found 1e-13

Top: dt is a string
dt = "1/60"
> bad.toml:1:6: dt: expected a number between 1e-12 and 1e15, found the string "1/60"

Top: dt is a number in quotes
dt = "0.01"
> bad.toml:1:6: dt: expected a number between 1e-12 and 1e15, found the string "0.01"; write the number without quotes

Top: dt NaN
dt = nan
> bad.toml:1:6: dt: expected a number between 1e-12 and 1e15, found nan

Top: dt infinite
dt = inf
> bad.toml:1:6: dt: expected a number between 1e-12 and 1e15, found inf

Top: dt beyond a double
dt = 1e400
> bad.toml:1:6: dt: expected a number between 1e-12 and 1e15, found 1e400

Top: dt beyond any integer
dt = 99999999999999999999999999999999999999999999999999999999
> bad.toml:1:6: dt: expected a number between 1e-12 and 1e15, found 9999999999999999999999999999999999999999…

Top: dt beyond any hexadecimal integer
dt = 0xffffffffffffffffffffffffffffffffffffffffffff
> bad.toml:1:6: dt: expected a number between 1e-12 and 1e15, found 0xffffffffffffffffffffffffffffffffffffff…

Top: dt just out of range
dt = 1_000_000_000_000_001
> bad.toml:1:6: dt: expected a number between 1e-12 and 1e15, found 1_000_000_000_000_001

Top: dt is a boolean
dt = true
> bad.toml:1:6: dt: expected a number between 1e-12 and 1e15, found true

Top: dt is a date
dt = 2006-01-31
> bad.toml:1:6: dt: expected a number between 1e-12 and 1e15, found the date-time 2006-01-31

Top: dt is a time
dt = 00:00:01
> bad.toml:1:6: dt: expected a number between 1e-12 and 1e15, found the date-time 00:00:01

Top: integrator misspelled
integrator = "exponetial"
> bad.toml:1:14: integrator: expected one of "thesis", "mps", "euler", "verlet", "rk4", "exponential", found the string "exponetial"; did you mean "exponential"?

Top: model misspelled
model = "metabals"
> bad.toml:1:9: model: expected one of "oscillators", "metaballs", "lattice", "fem", found the string "metabals"; did you mean "metaballs"?

Top: model is a table
model = {}
> bad.toml:1:9: model: expected one of "oscillators", "metaballs", "lattice", "fem", found a table

Top: integrator unknown
integrator = "leapfrog"
> bad.toml:1:14: integrator: expected one of "thesis", "mps", "euler", "verlet", "rk4", "exponential", found the string "leapfrog"

Top: integrator is a number
integrator = 4
> bad.toml:1:14: integrator: expected one of "thesis", "mps", "euler", "verlet", "rk4", "exponential", found 4

Top: integrator in capitals
integrator = "RK4"
> bad.toml:1:14: integrator: expected one of "thesis", "mps", "euler", "verlet", "rk4", "exponential", found the string "RK4"; did you mean "rk4"?

Material: omega negative
omega = -12.0
> bad.toml:3:9: material.omega: expected a number between 0 and 1e15, found -12.0

Material: damping is an array
damping = [1.5]
> bad.toml:3:11: material.damping: expected a number between 0 and 1e15, found an array of 1 value

Material: response unknown
response = "inertia"
> bad.toml:3:12: material.response: expected one of "rigid", "inertial", "world", found the string "inertia"; did you mean "inertial"?

Material: material key misspelled
dampening = 1.5
> bad.toml:3:1: material.dampening: unknown key; did you mean "damping"? (known keys: omega, damping, response)

Influence: influence key misspelled
aplha = 100
> bad.toml:3:1: influence.aplha: unknown key; did you mean "alpha"? (known keys: alpha, beta, reach, weight, scaling, merge_at, split_at, core_at, core_width, apart)

Influence: influence key with a hyphen
merge-at = 1.05
> bad.toml:3:1: influence.merge-at: unknown key; did you mean "merge_at"? (known keys: alpha, beta, reach, weight, scaling, merge_at, split_at, core_at, core_width, apart)

Influence: alpha negative
alpha = -100
> bad.toml:3:9: influence.alpha: expected a number between 0 and 1e15, found -100

Influence: beta is a table
beta = { value = 60 }
> bad.toml:3:8: influence.beta: expected a number between 0 and 1e15, found a table

Influence: reach zero
reach = 0.0
> bad.toml:3:9: influence.reach: expected a number between 1e-12 and 1e15, found 0.0

Influence: weight misspelled
weight = "liner"
> bad.toml:3:10: influence.weight: expected one of "linear", "wendland", found the string "liner"; did you mean "linear"?

Influence: scaling unknown
scaling = "none"
> bad.toml:3:11: influence.scaling: expected one of "relative", "absolute", found the string "none"

Influence: apart is a boolean
apart = false
> bad.toml:3:9: influence.apart: expected one of "repel", "none", found false

Influence: merge_at zero
merge_at = 0
> bad.toml:3:12: influence.merge_at: expected a number between 1e-12 and 1e15, found 0

Influence: split_at below merge_at
merge_at = 1.05
split_at = 0.9
> bad.toml:4:12: influence.split_at: expected a number of at least merge_at (1.05), found 0.9

Influence: split_at below the default merge_at
split_at = 0.9
> bad.toml:3:12: influence.split_at: expected a number of at least merge_at (1.05 by default), found 0.9

Influence: merge_at above the default split_at
merge_at = 1.3
> bad.toml:3:12: influence.merge_at: expected a number of at most split_at (1.15 by default), found 1.3; give split_at, too

Influence: core_at negative
core_at = -0.1
> bad.toml:3:11: influence.core_at: expected a number between 0 and 1e15, found -0.1

Influence: core_at at merge_at
merge_at = 1.0
split_at = 1.0
core_at = 1.0
> bad.toml:5:11: influence.core_at: expected a number below merge_at (1.0), found 1.0

Influence: core_at above the default merge_at
core_at = 1.2
> bad.toml:3:11: influence.core_at: expected a number below merge_at (1.05 by default), found 1.2

Cells: lattice key misspelled
[lattice]
cell = 8
> bad.toml:3:1: lattice.cell: unknown key; did you mean "cells"? (known keys: cells, tear, limit)

Cells: one cell
[lattice]
cells = 1
> bad.toml:3:9: lattice.cells: expected an integer from 2 to 256, found 1

Cells: another way to tear
[lattice]
tear = "cuts"
> bad.toml:3:8: lattice.tear: expected one of "none", "cut", "split", found the string "cuts"; did you mean "cut"?

Cells: a limit of zero
[lattice]
limit = 0
> bad.toml:3:9: lattice.limit: expected a number between 1e-3 and 1e3, found 0

Cells: an incompressible material
[fem]
poisson = 0.5
> bad.toml:3:11: fem.poisson: expected a number between -0.9 and 0.49, found 0.5

Cells: no stiffness
[fem]
young = 0
> bad.toml:3:9: fem.young: expected a number between 1e-12 and 1e15, found 0

Body: body key misspelled
raduis = 1
> bad.toml:3:1: body["ball"].raduis: unknown key; did you mean "radius"? (known keys: name, radius, shape, motion, mass, group, color, omega, damping, response, reach)

Body: body key of a push
start = 1
> bad.toml:3:1: body["ball"].start: unknown key; "start" belongs in a [[point]] or in a [[push]] (known keys: name, radius, shape, motion, mass, group, color, omega, damping, response, reach)

Body: name with a space
name = "a b"
> bad.toml:3:8: body[0].name: expected a name of 1 to 64 letters, digits, - and _, found the string "a b"

Body: name with a slash
name = "../a"
> bad.toml:3:8: body[0].name: expected a name of 1 to 64 letters, digits, - and _, found the string "../a"

Body: name not ASCII
name = "ä"
> bad.toml:3:8: body[0].name: expected a name of 1 to 64 letters, digits, - and _, found the string "ä"

Body: name too long
name = "aaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaa"
> bad.toml:3:8: body[0].name: expected a name of 1 to 64 letters, digits, - and _, found the string "aaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaa…"

Body: name is a number
name = 1
> bad.toml:3:8: body[0].name: expected a name of 1 to 64 letters, digits, - and _, found 1

Body: radius zero
radius = 0
> bad.toml:3:10: body["ball"].radius: expected a number between 1e-12 and 1e15, found 0

Body: radius negative
radius = -1.0
> bad.toml:3:10: body["ball"].radius: expected a number between 1e-12 and 1e15, found -1.0

Body: radius tiny
radius = 1e-300
> bad.toml:3:10: body["ball"].radius: expected a number between 1e-12 and 1e15, found 1e-300

Body: radius huge
radius = 1e16
> bad.toml:3:10: body["ball"].radius: expected a number between 1e-12 and 1e15, found 1e16

Body: body omega not finite
omega = -inf
> bad.toml:3:9: body["ball"].omega: expected a number between 0 and 1e15, found -inf

Body: body response unknown
response = "Rigid"
> bad.toml:3:12: body["ball"].response: expected one of "rigid", "inertial", "world", found the string "Rigid"; did you mean "rigid"?

Body: shape is a string
shape = "sphere"
> bad.toml:3:9: body["ball"].shape: expected a table such as { sphere = { stacks = 12, slices = 24 } }, found the string "sphere"

Body: shape is empty
shape = {}
> bad.toml:3:9: body["ball"].shape.sphere: missing, expected a table such as { stacks = 12, slices = 24 }

Body: two shapes
shape = { sphere = { stacks = 12, slices = 24 }, mesh = "blob.obj" }
> bad.toml:3:9: body["ball"].shape: expected exactly one of sphere, mesh, found sphere and mesh

Body: shape unknown
shape = { cube = 1 }
> bad.toml:3:11: body["ball"].shape.cube: unknown key (known keys: sphere, mesh)

Body: shape with a misplaced key
shape = { stacks = 12 }
> bad.toml:3:11: body["ball"].shape.stacks: unknown key; "stacks" belongs in shape = { sphere = { … } } (known keys: sphere, mesh)

Body: sphere is a number
shape = { sphere = 12 }
> bad.toml:3:20: body["ball"].shape.sphere: expected a table such as { stacks = 12, slices = 24 }, found 12

Body: sphere key misspelled
shape = { sphere = { stacks = 12, slice = 24 } }
> bad.toml:3:35: body["ball"].shape.sphere.slice: unknown key; did you mean "slices"? (known keys: stacks, slices)

Body: stacks too few
shape = { sphere = { stacks = 1 } }
> bad.toml:3:31: body["ball"].shape.sphere.stacks: expected an integer from 2 to 65535, found 1

Body: slices too few
shape = { sphere = { slices = 2 } }
> bad.toml:3:31: body["ball"].shape.sphere.slices: expected an integer from 3 to 65535, found 2

Body: slices too many
shape = { sphere = { slices = 65536 } }
> bad.toml:3:31: body["ball"].shape.sphere.slices: expected an integer from 3 to 65535, found 65536

Body: stacks too many
shape = { sphere = { stacks = 9999999999999999999999 } }
> bad.toml:3:31: body["ball"].shape.sphere.stacks: expected an integer from 2 to 65535, found 9999999999999999999999

Body: stacks not an integer
shape = { sphere = { stacks = 12.0 } }
> bad.toml:3:31: body["ball"].shape.sphere.stacks: expected an integer from 2 to 65535, found 12.0

Body: slices negative
shape = { sphere = { slices = -24 } }
> bad.toml:3:31: body["ball"].shape.sphere.slices: expected an integer from 3 to 65535, found -24

Body: motion is a vector
motion = [0, 0, 0]
> bad.toml:3:10: body["ball"].motion: expected a table such as { fixed = [0, 0, 0] }, found an array of 3 values

Body: motion is empty
motion = {}
> bad.toml:3:10: body["ball"].motion: expected exactly one of fixed, line, sine, keyframes, free, found none

Body: motion unknown
motion = { spiral = [0, 0, 0] }
> bad.toml:3:12: body["ball"].motion.spiral: unknown key (known keys: fixed, line, sine, keyframes, free)

Body: motion misspelled
motion = { keyframe = [[0, 0, 0, 0], [1, 0, 0, 0]] }
> bad.toml:3:12: body["ball"].motion.keyframe: unknown key; did you mean "keyframes"? (known keys: fixed, line, sine, keyframes, free)

Body: two motions
motion = { fixed = [0, 0, 0], line = { from = [0, 0, 0], velocity = [1, 0, 0] } }
> bad.toml:3:10: body["ball"].motion: expected exactly one of fixed, line, sine, keyframes, free, found fixed and line

Body: fixed with two numbers
motion = { fixed = [0, 0] }
> bad.toml:3:20: body["ball"].motion.fixed: expected an array of 3 numbers [x, y, z], found an array of 2 values

Body: fixed with four numbers
motion = { fixed = [0, 0, 0, 0] }
> bad.toml:3:20: body["ball"].motion.fixed: expected an array of 3 numbers [x, y, z], found an array of 4 values

Body: fixed is a number
motion = { fixed = 0 }
> bad.toml:3:20: body["ball"].motion.fixed: expected an array of 3 numbers [x, y, z], found 0

Body: fixed holds a string
motion = { fixed = [0, "0", 0] }
> bad.toml:3:24: body["ball"].motion.fixed[1]: expected a number between -1e15 and 1e15, found the string "0"; write the number without quotes

Body: fixed not finite
motion = { fixed = [0, 0, nan] }
> bad.toml:3:27: body["ball"].motion.fixed[2]: expected a number between -1e15 and 1e15, found nan

Body: fixed out of range
motion = { fixed = [-1e16, 0, 0] }
> bad.toml:3:21: body["ball"].motion.fixed[0]: expected a number between -1e15 and 1e15, found -1e16

Body: line is a vector
motion = { line = [1, 0, 0] }
> bad.toml:3:19: body["ball"].motion.line: expected a table such as { from = [0, 0, 0], velocity = [1, 0, 0] }, found an array of 3 values

Body: line without a velocity
motion = { line = { from = [0, 0, 0] } }
> bad.toml:3:19: body["ball"].motion.line.velocity: missing, expected an array of 3 numbers [x, y, z]

Body: line key misspelled
motion = { line = { form = [0, 0, 0], velocity = [1, 0, 0] } }
> bad.toml:3:21: body["ball"].motion.line.form: unknown key; did you mean "from"? (known keys: from, velocity)

Body: sine without a frequency
motion = { sine = { center = [0, 0, 0], amplitude = [1, 0, 0] } }
> bad.toml:3:19: body["ball"].motion.sine.frequency: missing, expected a number between 0 and 1e15

Body: sine with a British centre
motion = { sine = { centre = [0, 0, 0], amplitude = [1, 0, 0], frequency = 1 } }
> bad.toml:3:21: body["ball"].motion.sine.centre: unknown key; did you mean "center"? (known keys: center, amplitude, frequency, phase)

Body: sine of negative frequency
motion = { sine = { center = [0, 0, 0], amplitude = [1, 0, 0], frequency = -0.25 } }
> bad.toml:3:76: body["ball"].motion.sine.frequency: expected a number between 0 and 1e15, found -0.25

Body: sine of infinite frequency
motion = { sine = { center = [0, 0, 0], amplitude = [1, 0, 0], frequency = inf } }
> bad.toml:3:76: body["ball"].motion.sine.frequency: expected a number between 0 and 1e15, found inf

Body: sine phase in words
motion = { sine = { center = [0, 0, 0], amplitude = [1, 0, 0], frequency = 1, phase = "pi" } }
> bad.toml:3:87: body["ball"].motion.sine.phase: expected a number between -1e15 and 1e15, found the string "pi"

Body: one key
motion = { keyframes = [[0, 0, 0, 0]] }
> bad.toml:3:24: body["ball"].motion.keyframes: expected an array of two or more keys [t, x, y, z], found an array of 1 value

Body: no keys
motion = { keyframes = [] }
> bad.toml:3:24: body["ball"].motion.keyframes: expected an array of two or more keys [t, x, y, z], found an empty array

Body: keys are a table
motion = { keyframes = { t = 0 } }
> bad.toml:3:26: body["ball"].motion.keyframes.t: unknown key (known keys: keys, interpolation)

Body: a key of three numbers
motion = { keyframes = [[0, 0, 0, 0], [1, 0, 0]] }
> bad.toml:3:39: body["ball"].motion.keyframes[1]: expected a key [t, x, y, z], found an array of 3 values

Body: a key that is a number
motion = { keyframes = [0, 1] }
> bad.toml:3:25: body["ball"].motion.keyframes[0]: expected a key [t, x, y, z], found 0

Body: a key not finite
motion = { keyframes = [[0, 0, 0, 0], [1, 0, -inf, 0]] }
> bad.toml:3:46: body["ball"].motion.keyframes[1][2]: expected a number between -1e15 and 1e15, found -inf

Body: keys of one time
motion = { keyframes = [[0, 0, 0, 0], [1, 0, 0, 0], [1, 1, 0, 0]] }
> bad.toml:3:53: body["ball"].motion.keyframes[2]: expected a time at least 1e-12 after that of the previous key (1.0), found 1.0; the times of keys must increase

Body: keys out of order
motion = { keyframes = [[0, 0, 0, 0], [2, 0, 0, 0], [1, 1, 0, 0]] }
> bad.toml:3:53: body["ball"].motion.keyframes[2]: expected a time at least 1e-12 after that of the previous key (2.0), found 1.0; the times of keys must increase

Body: keys too close
motion = { keyframes = [[0, 0, 0, 0], [1e-13, 1, 0, 0]] }
> bad.toml:3:39: body["ball"].motion.keyframes[1]: expected a time at least 1e-12 after that of the previous key (0.0), found 1e-13; the times of keys must increase

Push: push of no body
body = "b"
> bad.toml:7:8: push[0].body: expected the name of a body, found the string "b" (bodies: ball)

Push: push of a body misspelled
body = "balk"
> bad.toml:7:8: push[0].body: expected the name of a body, found the string "balk"; did you mean "ball"? (bodies: ball)

Push: push of a number
body = 0
> bad.toml:7:8: push[0].body: expected the name of a body, found 0 (bodies: ball)

Push: push key misspelled
strenght = 60
> bad.toml:7:1: push[0].strenght: unknown key; did you mean "strength"? (known keys: body, direction, strength, start, duration)

Push: push without direction
direction = [0, 0, 0]
> bad.toml:7:13: push[0].direction: expected a direction, found the zero vector

Push: push direction negative zero
direction = [0.0, -0.0, 0]
> bad.toml:7:13: push[0].direction: expected a direction, found the zero vector

Push: push direction flat
direction = [1, 0]
> bad.toml:7:13: push[0].direction: expected an array of 3 numbers [x, y, z], found an array of 2 values

Push: push direction not finite
direction = [1, inf, 0]
> bad.toml:7:17: push[0].direction[1]: expected a finite number, found inf

Push: push strength not finite
strength = nan
> bad.toml:7:12: push[0].strength: expected a number between -1e15 and 1e15, found nan

Push: push start negative
start = -0.2
> bad.toml:7:9: push[0].start: expected a number between 0 and 1e15, found -0.2

Push: push duration negative
duration = -0.1
> bad.toml:7:12: push[0].duration: expected a number between 0 and 1e15, found -0.1

Push: push duration in words
duration = "0.1 s"
> bad.toml:7:12: push[0].duration: expected a number between 0 and 1e15, found the string "0.1 s"

Whole: too many steps
dt = 0.001
duration = 1e10
[[body]]
name = "a"
radius = 1
motion = { fixed = [0, 0, 0] }
> bad.toml:2:12: duration: expected at most 1e12 steps of dt (0.001 s), found 1e10; shorten duration or raise dt

Whole: gravity is a number
gravity = 9.81
duration = 4
[[body]]
name = "a"
radius = 1
motion = { fixed = [0, 0, 0] }
> bad.toml:1:11: gravity: expected an array of 3 numbers [x, y, z], found 9.81

Whole: a free body that responds otherwise
duration = 4
[[body]]
name = "a"
radius = 1
response = "world"
motion = { free = { from = [0, 0, 0] } }
> bad.toml:5:12: body["a"].response: expected "inertial", the response of every free body, found the string "world"

Whole: a free body among others that respond otherwise
duration = 4
material = { response = "rigid" }
[[body]]
name = "a"
radius = 1
motion = { free = { from = [0, 0, 0] } }
> bad.toml:6:19: body["a"].motion.free: expected a body whose response is "inertial", found another one in [material]; give the body response = "inertial", the response of every free body

Whole: a free body that turns somehow
duration = 4
[[body]]
name = "a"
radius = 1
motion = { free = { from = [0, 0, 0], rotation = "some" } }
> bad.toml:5:50: body["a"].motion.free.rotation: expected one of "free", "fixed", found the string "some"

Body: no mass
mass = 0
> bad.toml:3:8: body["ball"].mass: expected a number between 1e-12 and 1e15, found 0

Body: a color by name
color = "red"
> bad.toml:3:9: body["ball"].color: expected a color "#rrggbb", found the string "red"

Body: a group named like a body
group = "ball"
> bad.toml:3:9: body["ball"].group: expected a name that no body has (the body at line 4 has this one), found the string "ball"

Whole: an interpolation that does not exist
duration = 4
[[body]]
name = "a"
radius = 1
motion = { keyframes = { keys = [[0, 0, 0, 0], [1, 1, 0, 0]], interpolation = "cubic" } }
> bad.toml:5:79: body["a"].motion.keyframes.interpolation: expected one of "spline", "linear", "hold", found the string "cubic"

Whole: keyframes without keys
duration = 4
[[body]]
name = "a"
radius = 1
motion = { keyframes = { interpolation = "hold" } }
> bad.toml:5:24: body["a"].motion.keyframes.keys: missing, expected an array of two or more keys [t, x, y, z]

Whole: a plane without a direction
duration = 4
plane = [{ normal = [0, 0, 0] }]
[[body]]
name = "a"
radius = 1
motion = { fixed = [0, 0, 0] }
> bad.toml:2:21: plane[0].normal: expected a direction, found the zero vector

Whole: a core without a rim
duration = 4
influence = { core_width = 0.1 }
[[body]]
name = "a"
radius = 1
motion = { fixed = [0, 0, 0] }
> bad.toml:2:28: influence.core_width: expected 0 where there is no core, found 0.1; give core_at, too

Whole: a pair of one body
duration = 4
[[body]]
name = "a"
radius = 1
motion = { fixed = [0, 0, 0] }
[[pair]]
bodies = ["a", "a"]
> bad.toml:7:10: pair[0].bodies: expected two bodies, found one twice; name the body and another one

Whole: a pair with nobody
duration = 4
[[body]]
name = "ball"
group = "balls"
radius = 1
motion = { fixed = [0, 0, 0] }
[[pair]]
bodies = ["balls", "bell"]
> bad.toml:8:20: pair[0].bodies[1]: expected the name of a body or a group, found the string "bell"; did you mean "ball"? (bodies: balls, ball)

Whole: a pair that splits before it merges
duration = 4
[influence]
split_at = 1.2
[[body]]
name = "a"
group = "g"
radius = 1
motion = { fixed = [0, 0, 0] }
[[pair]]
bodies = ["a", "g"]
merge_at = 1.3
> bad.toml:11:12: pair[0].merge_at: expected a number of at most split_at (1.2 by default), found 1.3; give split_at, too

Whole: two laws for a pair
duration = 4
[[grid]]
name = "a"
group = "g"
count = [2, 1, 1]
spacing = [3, 0, 0]
radius = 1
motion = { fixed = [0, 0, 0] }
[[pair]]
bodies = ["g", "g"]
alpha = 50
[[pair]]
bodies = ["a-0-0-0", "a-1-0-0"]
> bad.toml:13:10: pair[1].bodies: expected pairs without a [[pair]] so far, found some of the one at line 9; each pair of bodies can have one [[pair]]: join the two, or divide the groups

Whole: a grid of too many
duration = 4
[[grid]]
name = "a"
count = [1000, 1000, 2]
spacing = [3, 3, 3]
radius = 1
motion = { fixed = [0, 0, 0] }
> bad.toml:4:9: grid["a"].count: expected at most 1000000 bodies, or keys of their paths, of all grids together, found 1000 × 1000 × 2 bodies

Whole: a grid of none
duration = 4
[[grid]]
name = "a"
count = [1, 0, 2]
spacing = [3, 3, 3]
radius = 1
motion = { fixed = [0, 0, 0] }
> bad.toml:4:13: grid["a"].count[1]: expected an integer from 1 to 1000000, found 0

Whole: a grid with a body's name
duration = 4
[[body]]
name = "a-1-0-0"
radius = 1
motion = { fixed = [0, 0, 0] }
[[grid]]
name = "a"
count = [2, 1, 1]
spacing = [3, 3, 3]
radius = 1
motion = { fixed = [0, 0, 0] }
> bad.toml:7:8: grid["a"].name: expected a name that no other body has (the body or grid at line 3 has the name "a-1-0-0" of one of them), found the string "a"
"##;

/// More cases, which are easier to read escaped: part, lines, message.
const BROKEN_ESCAPED: &[(&str, &str, &str)] = &[
    ("Whole", "", "bad.toml:1:1: body: missing, expected at least one [[body]]"),
    (
        "Whole",
        "name = \"a\u{1b}[31mb\"\n",
        "bad.toml:1:10: name: not valid TOML: invalid basic string, expected non-double-quote visible characters, `\\`, \
         found \"\\u{1b}\"",
    ),
    // a byte order mark does not count as a character; a two-byte character counts as one
    (
        "Whole",
        "\u{feff}\"größe\" = 1\n",
        "bad.toml:1:1: \"größe\": unknown key (known keys: name, dt, duration, integrator, tolerance, gravity, model, material, influence, lattice, fem, surface, mesh, body, grid, pair, plane, point, push, edit)",
    ),
    (
        "Whole",
        "name = \"two\"\r\nduration = \"4\"\r\n[[body]]\r\n",
        "bad.toml:2:12: duration: expected a number between 1e-12 and 1e15, found the string \"4\"; write the number \
         without quotes",
    ),
    (
        "Top",
        "\"name of \\\"it\\\"\\n\" = 1",
        "bad.toml:1:1: \"name of \\\"it\\\"\\n\": unknown key (known keys: name, dt, duration, integrator, tolerance, gravity, model, material, influence, lattice, fem, surface, mesh, body, grid, pair, plane, point, push, edit)",
    ),
    (
        "Top",
        "name = \"\"\"\na\nb\u{202e}\"\"\"",
        "bad.toml:1:8: name: expected a name of 1 to 200 characters on one line, found the string \"a\\nb\\u{202e}\"",
    ),
];

/// An otherwise valid scene file with `lines` in its `part`.
fn file_with(part: &str, lines: &str) -> String {
    const BODY: &str = "name = \"ball\"\nradius = 1\nmotion = { fixed = [0, 0, 0] }\n";
    const POINT: &str = "name = \"hand\"\nradius = 1\nact = \"attract\"\nmotion = { fixed = [0, 0, 0] }\n";
    const PUSH: &str = "body = \"ball\"\ndirection = [1, 0, 0]\nstrength = 60\nstart = 0.2\nduration = 0.1\n";
    let key = |line: &str| line.split(' ').next().unwrap_or_default().to_owned();
    let others = |all: &str| -> String {
        let others = all.lines().filter(|line| lines.lines().all(|given| key(given) != key(line)));
        others.flat_map(|line| [line, "\n"]).collect()
    };
    match part {
        "Whole" => format!("{lines}\n"),
        "Top" => format!("{lines}\nduration = 4\n[[body]]\n{BODY}"),
        "Material" => format!("duration = 4\n[material]\n{lines}\n[[body]]\n{BODY}"),
        "Influence" => format!("duration = 4\n[influence]\n{lines}\n[[body]]\n{BODY}"),
        "Cells" => format!("duration = 4\n{lines}\n[[body]]\n{BODY}"),
        "Body" => format!("duration = 4\n[[body]]\n{lines}\n{}", others(BODY)),
        "Point" => format!("duration = 4\n[[body]]\n{BODY}[[point]]\n{lines}\n{}", others(POINT)),
        "Edit" => format!("duration = 4\n[[body]]\n{BODY}[[edit]]\n{lines}\n{}", others("time = 1\n")),
        "Push" => format!("duration = 4\n[[body]]\n{BODY}[[push]]\n{lines}\n{}", others(PUSH)),
        _ => panic!("no part of a scene file: {part}"),
    }
}

fn rejection(text: &str) -> SceneError {
    match Scene::parse(text, "bad.toml") {
        Ok(_) => panic!("accepted:\n{text}"),
        Err(error) => error,
    }
}

#[test]
fn every_broken_file_is_rejected_with_this_message() {
    let blocks: Vec<&str> = BROKEN.trim().split("\n\n").collect();
    assert!(blocks.len() >= 140, "only {} cases", blocks.len());
    let blocks = blocks.into_iter().map(|block| {
        let (title, rest) = block.split_once('\n').expect("a title");
        let (lines, message) = rest.split_once("\n> ").or(rest.strip_prefix("> ").map(|m| ("", m))).expect("a message");
        (title.split(':').next().expect("a part"), lines, message)
    });
    let mut wrong = Vec::new();
    for (part, lines, message) in blocks.chain(BROKEN_ESCAPED.iter().copied()) {
        let found = rejection(&file_with(part, lines)).to_string();
        if found != message {
            wrong.push(format!("{part}:\n{lines}\n  expected {message}\n  found    {found}"));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n\n")); // all at once: a test takes long to build
}

/// The files that [`file_with`] builds around a case are valid, so a case is rejected for its own lines.
#[test]
fn the_files_around_the_broken_lines_are_valid() {
    for (part, lines) in [
        ("Top", "name = \"two\""),
        ("Material", "omega = 12"),
        ("Influence", "alpha = 100"),
        ("Body", "radius = 2"),
        ("Point", "radius = 2"),
        ("Push", "strength = 2"),
    ] {
        let text = file_with(part, lines);
        let scene = Scene::parse(&text, "good.toml").unwrap_or_else(|error| panic!("{error}\n{text}"));
        assert_valid(&scene);
    }
}

#[test]
fn an_error_has_its_parts_as_fields() {
    let error = rejection(&file_with("Influence", "merge_at = 1.3"));
    assert_eq!((error.file.as_str(), error.line(), error.column()), ("bad.toml", Some(3), Some(12)));
    assert_eq!(error.key, "influence.merge_at");
    assert_eq!(error.message, "expected a number of at most split_at (1.15 by default), found 1.3");
    assert_eq!(error.help.as_deref(), Some("give split_at, too"));
    assert_eq!(error, error.clone());
}

#[test]
fn a_truncated_file_is_reported() {
    let message = "bad.toml:1:11: body: not valid TOML: unclosed array, expected `]`, found the end of the file";
    assert_eq!(rejection("body = [{}").to_string(), message);
}

#[test]
fn a_file_name_cannot_break_the_line() {
    let error = Scene::parse("", "a\nb\u{1b}.toml").expect_err("an empty file");
    assert_eq!(error.to_string(), "a\\nb\\u{1b}.toml:1:1: body: missing, expected at least one [[body]]");
}

#[test]
fn the_nearest_of_many_bodies_is_suggested() {
    let mut text = String::from("duration = 4\n");
    for i in 0..20 {
        text += &format!("[[body]]\nname = \"ball_{i}\"\nradius = 1\nmotion = {{ fixed = [{i}, 0, 0] }}\n");
    }
    text += "[[push]]\nbody = \"ball-17\"\ndirection = [1, 0, 0]\nstrength = 60\nstart = 0.2\nduration = 0.1\n";
    assert_eq!(
        rejection(&text).to_string(),
        "bad.toml:83:8: push[0].body: expected the name of a body, found the string \"ball-17\"; did you mean \
         \"ball_17\"? (bodies: ball_0, ball_1, ball_2, ball_3, ball_4, ball_5, ball_6, ball_7, …)"
    );
}

/// Deep nesting overflows the stack neither in parsing nor in dropping.
#[test]
fn deep_nesting_does_not_overflow_the_stack() {
    let deep = 100_000;
    for (open, message) in [
        ("[", "bad.toml:1:85: x: not valid TOML: cannot recurse further; max recursion depth met, found \"[\""),
        ("{ a = ", "bad.toml:1:485: x: not valid TOML: cannot recurse further; max recursion depth met, found \"{\""),
    ] {
        assert_eq!(rejection(&format!("x = {}", open.repeat(deep))).to_string(), message);
    }
    let dotted = vec!["a"; deep].join(".");
    assert_eq!(rejection(&format!("{dotted} = 1")).to_string(), "\"bad.toml\" is not valid TOML: recursion limit");
    rejection(&"[".repeat(deep));
    rejection(&format!("[{dotted}]"));

    // the deepest nesting that the TOML parser accepts: dotted keys in inline tables, 6,000 nested tables
    let dotted = vec!["a"; 79].join(".");
    let nest = |n: usize| format!("[{dotted}]\n{dotted} = {}1{}\n", format!("{{ {dotted} = ").repeat(n), "}".repeat(n));
    assert!(rejection(&nest(78)).to_string().starts_with("bad.toml:1:2: a: unknown key"));
    rejection(&format!("{}x = y", nest(78)));
}

/// A file in the temporary folder, removed when the test ends.
struct Temporary(PathBuf);

impl Temporary {
    fn new(name: &str) -> Temporary {
        Temporary(std::env::temp_dir().join(format!("meldscope-{}-{name}", std::process::id())))
    }

    fn holding(name: &str, bytes: &[u8]) -> Temporary {
        let file = Temporary::new(name);
        std::fs::write(&file.0, bytes).expect("a file can be written");
        file
    }

    fn rejection(&self) -> String {
        Scene::load(&self.0).expect_err("a broken file").to_string().replace(&self.0.display().to_string(), "FILE")
    }
}

impl Drop for Temporary {
    fn drop(&mut self) {
        std::fs::remove_file(&self.0).ok();
    }
}

#[test]
fn a_file_that_cannot_be_read_is_rejected_with_the_reason() {
    const HELP: &str = "give the path of a scene file or the name of a built-in scene (`meldscope scenes` lists them)";
    let missing = Temporary::new("missing.toml").rejection();
    assert!(missing.starts_with("cannot read \"FILE\": "), "{missing}");
    assert!(missing.ends_with(HELP), "{missing}");

    let folder = Scene::load(&std::env::temp_dir()).expect_err("a folder").to_string();
    assert!(folder.starts_with("cannot read \""), "{folder}");

    let nowhere = Scene::load(&PathBuf::from("a\0b")).expect_err("not a path").to_string();
    assert!(nowhere.starts_with("cannot read \"a\\0b\": "), "{nowhere}");
}

#[test]
fn a_file_that_is_not_text_is_rejected_with_the_position() {
    let latin1 = Temporary::holding("latin1.toml", b"duration = 4\nname = \"gr\xf6\xdfe\"\n");
    assert_eq!(latin1.rejection(), "FILE:2:11: not UTF-8: found the byte 0xf6 at offset 23; save the file as UTF-8");
    let cut = Temporary::holding("cut.toml", "name = \"ö".as_bytes().split_last().expect("bytes").1);
    let wide = Temporary::holding("wide.toml", b"d\0u\0");
    assert_eq!(
        wide.rejection(),
        "FILE:1:2: no text, or UTF-16: found the byte 0x00 at offset 1; save the file as UTF-8"
    );
    assert_eq!(cut.rejection(), "FILE:1:9: not UTF-8: found the byte 0xc3 at offset 8; save the file as UTF-8");
}

#[test]
fn an_oversized_file_is_rejected() {
    let large = Temporary::new("large.toml");
    let file = std::fs::File::create(&large.0).expect("a file");
    file.set_len((64 << 20) + 1).expect("a sparse file");
    assert_eq!(large.rejection(), "\"FILE\" is larger than 32 MiB, the limit for scene files");
    if cfg!(target_os = "linux") {
        let endless = Scene::load(&PathBuf::from("/dev/zero")).expect_err("an endless file").to_string();
        assert_eq!(endless, "\"/dev/zero\" is larger than 32 MiB, the limit for scene files");
    }
}

/// Holds for any text: no panic; a valid scene, or a one-line error at a position that exists in the text.
fn assert_sane(text: &str) {
    match Scene::parse(text, "some.toml") {
        Ok(scene) => assert_valid(&scene),
        Err(error) => {
            let shown = error.to_string();
            assert!(!shown.chars().any(char::is_control), "{shown:?}");
            assert!(shown.chars().count() < 1000, "{shown}");
            if let Some(place) = error.place {
                let line = text.split('\n').nth(place.line as usize - 1).expect("a line of the text");
                assert!((1..=line.chars().count() + 1).contains(&(place.column as usize)), "{shown}");
            }
        }
    }
}

/// Words that scene files consist of, and words that break table parsers.
const WORDS: &str =
    "name dt duration integrator tolerance material influence body push omega damping response alpha merge_at
    split_at core_at radius shape sphere stacks slices motion fixed line sine keyframes from center direction strength
    start [ ] [[ ]] { } = . , \" \"\"\" ' \\ # [body] [[body]] [[push]] [0,0,0] {fixed=[0,0,0]} \"a\" \"rk4\" 1979-05-27
    true ä \u{feff} \u{0} \u{202e}";

/// Numbers at the limits of a type or of scene values, and malformed numbers.
const EXTREMES: &str =
    "0 -0.0 1 -1 1.05 1e15 -1e15 1.0000000000000002e15 1e-12 9e-13 1e-15 1e308 -1e308 1e309 5e-324 nan
    -nan inf -inf 65535 65536 4294967296 9223372036854775807 99999999999999999999 0xffffffffffffffff 0b1
    123456789012345.6 340282366920938463463374607431768211456 \"1\" [] {} true";

/// A word or a number as above, or white space.
fn token() -> impl Strategy<Value = &'static str> {
    let tokens: Vec<&str> = WORDS.split_whitespace().chain(EXTREMES.split_whitespace()).collect();
    prop_oneof![3 => prop::sample::select(tokens), 1 => prop::sample::select(&[" ", "\n", "\r\n"])]
}

/// One of the extreme numbers.
fn extreme() -> impl Strategy<Value = &'static str> {
    prop::sample::select(EXTREMES.split_whitespace().collect::<Vec<_>>())
}

/// A way to damage a text; the numbers are positions.
#[derive(Clone, Debug)]
enum Damage {
    FlipBit(usize, u8),
    Truncate(usize),
    SwapLines(usize, usize),
    RepeatLine(usize),
    DropLine(usize),
    ReplaceNumber(usize, &'static str),
    Insert(usize, &'static str),
}

fn damage() -> impl Strategy<Value = Damage> {
    let at = 0..10_000usize;
    prop_oneof![
        2 => (at.clone(), 0..8u8).prop_map(|(at, bit)| Damage::FlipBit(at, bit)),
        1 => at.clone().prop_map(Damage::Truncate),
        2 => (at.clone(), at.clone()).prop_map(|(a, b)| Damage::SwapLines(a, b)),
        1 => at.clone().prop_map(Damage::RepeatLine),
        1 => at.clone().prop_map(Damage::DropLine),
        8 => (at.clone(), extreme()).prop_map(|(at, number)| Damage::ReplaceNumber(at, number)),
        2 => (at, token()).prop_map(|(at, token)| Damage::Insert(at, token)),
    ]
}

impl Damage {
    fn apply(&self, text: &str) -> String {
        let mut lines: Vec<&str> = text.split('\n').collect();
        let count = lines.len();
        match *self {
            Damage::FlipBit(at, bit) => {
                let mut bytes = text.as_bytes().to_vec();
                if let Some(byte) = bytes.get_mut(at % text.len().max(1)) {
                    *byte ^= 1 << bit;
                }
                return String::from_utf8_lossy(&bytes).into_owned();
            }
            Damage::Truncate(at) => return text[..text.floor_char_boundary(at % (text.len() + 1))].to_owned(),
            Damage::Insert(at, token) => {
                let (before, after) = text.split_at(text.floor_char_boundary(at % (text.len() + 1)));
                return format!("{before}{token}{after}");
            }
            Damage::ReplaceNumber(at, number) => {
                let is_number = |word: &str| word.parse::<f64>().is_ok();
                let words: Vec<&str> = text.split_inclusive([' ', ',', '[', ']', '\n']).collect();
                let numbers: Vec<usize> = (0..words.len())
                    .filter(|&i| is_number(words[i].trim_end_matches([' ', ',', '[', ']', '\n'])))
                    .collect();
                let Some(&chosen) = numbers.get(at % numbers.len().max(1)) else { return text.to_owned() };
                let word = words[chosen];
                let end = &word[word.trim_end_matches([' ', ',', '[', ']', '\n']).len()..];
                return format!("{}{number}{end}{}", words[..chosen].concat(), words[chosen + 1..].concat());
            }
            Damage::SwapLines(a, b) => lines.swap(a % count, b % count),
            Damage::RepeatLine(at) => lines.insert(at % count, lines[at % count]),
            Damage::DropLine(at) => {
                lines.remove(at % count);
            }
        }
        lines.join("\n")
    }
}

#[test]
fn planes_are_limited() {
    let text = format!("{}{}", REFERENCES[0].1, "[[plane]]\nnormal = [0, 0, 1]\n".repeat(1001));
    let error = Scene::parse(&text, "many.toml").unwrap_err().to_string();
    assert!(error.contains("plane: expected at most 1000 planes, found 1001"), "{error}");
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 1000, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn arbitrary_text_causes_no_panic(text in any::<String>()) {
        assert_sane(&text);
    }

    #[test]
    fn arbitrary_bytes_cause_no_panic(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
        assert_sane(&String::from_utf8_lossy(&bytes));
    }

    #[test]
    fn token_soup_causes_no_panic(tokens in prop::collection::vec(token(), 0..60)) {
        assert_sane(&tokens.concat());
    }

    #[test]
    fn lines_of_tokens_cause_no_panic(
        lines in prop::collection::vec((token(), token()), 0..12)
    ) {
        assert_sane(&lines.iter().map(|(key, value)| format!("{key} = {value}\n")).collect::<String>());
    }

    #[test]
    fn a_damaged_scene_is_rejected_or_valid(
        (_, text) in prop::sample::select(REFERENCES),
        damages in prop::collection::vec(damage(), 1..4)
    ) {
        assert_sane(&damages.iter().fold(text.to_owned(), |text, damage| damage.apply(&text)));
    }

    /// Replaces one number at a time, so that limits are hit often in otherwise valid scenes.
    #[test]
    fn extreme_numbers_are_rejected_or_harmless(
        (_, text) in prop::sample::select(REFERENCES),
        at in 0..100usize,
        number in prop_oneof![extreme().prop_map(str::to_owned), any::<f64>().prop_map(|x| format!("{x:e}"))]
    ) {
        let marked = Damage::ReplaceNumber(at, "NUMBER").apply(text);
        assert_sane(&marked.replace("NUMBER", &number));
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 50, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn arbitrary_files_cause_no_panic(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
        let file = Temporary::holding("bytes.toml", &bytes);
        if let Err(error) = Scene::load(&file.0) {
            prop_assert!(!error.to_string().chars().any(char::is_control));
        }
    }
}
