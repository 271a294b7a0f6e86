"""Looks of users: a GLSL file with `vec4 look(float value, vec3 gradient, vec3 position)`, checked before it is drawn.

What a user writes reaches drivers and CPUs only after the compiler has read it, and in a form that can neither hang nor
crash them: loops end, indices stay inside of arrays, and variables begin as 0. That form is GLSL, too, so that it is
the same for both. The lines stay those of the user's file.
"""

from __future__ import annotations

from dataclasses import dataclass

MOST_ITERATIONS = 256
"""Most iterations of all loops of a look together, for a sample; where there might be more, loops end then."""


@dataclass(frozen=True)
class Look:
    text: str  # GLSL that drivers and CPUs may compile
    names: tuple[str, ...]  # that the file defines
    iterations: int  # of loops, at most, for a sample
    is_guarded: bool  # loops count their iterations
    uses_gradient: bool  # it reads the gradient

    def glsl(self, suffix: str = "") -> str:
        """Return GLSL that defines the look as `users_look`, and nothing else under a name that others may use.

        `suffix`: of that name, and of all others; for each of several volumes its own.
        """
        own = {name: f"user{suffix}_{name}" for name in self.names}
        reset = f" look_iterations{suffix} = 0;" if self.is_guarded else ""
        counter = (
            f"int look_iterations{suffix};\n"
            f"bool look_goes_on{suffix}() {{ return ++look_iterations{suffix} <= {MOST_ITERATIONS}; }}\n"
        )
        if self.is_guarded and suffix:
            own["look_goes_on"] = f"look_goes_on{suffix}"
        return "".join(
            [
                counter if self.is_guarded else "",
                *(f"#define {name} {other}\n" for name, other in own.items()),
                self.text.rstrip("\n") + "\n",
                *(f"#undef {name}\n" for name in own),
                f"vec4 users_look{suffix}(float value, vec3 gradient, vec3 position) {{{reset} "
                f"return {own['look']}(value, gradient, position); }}\n",
            ]
        )
