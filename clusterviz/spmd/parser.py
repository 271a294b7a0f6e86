"""Syntax of the GLSL subset: recursive descent, with binary operators by precedence.

A parser generator (lark) was measured: importing it and building its tables took longer than all else that is done to
compile a shader for the first time, and its tree had to be read again to be checked.
"""

from __future__ import annotations

from clusterviz.errors import InputError
from clusterviz.spmd import ir
from clusterviz.spmd.checker import Checker
from clusterviz.spmd.source import ShaderSource
from clusterviz.spmd.tokens import Token, tokens_of
from clusterviz.spmd.types import BOOL, DOUBLE, FLOAT, INT, SAMPLERS, UINT, VOID, Type, array_of, whole

LEVELS = ("||", "^^", "&&", "|", "^", "&", "== !=", "< > <= >=", "<< >>", "+ -", "* / %")
PRECEDENCE = {sign: level for level, signs in enumerate(LEVELS, start=1) for sign in signs.split()}
ASSIGNMENTS = {"=", *(sign + "=" for sign in ["+", "-", "*", "/", "%", "&", "|", "^", "<<", ">>"])}
DIRECTIONS = ("in", "out", "inout", "const", "precise")


def parse(source: ShaderSource) -> ir.Program:
    """Return the typed program of an assembled shader.

    Raises InputError: the first mistake, with file, line and column; also for what GLSL has and the subset does not.
    """
    parser = _Parser(source)
    try:
        return parser.program()
    except RecursionError:
        raise parser.error_here("nested too deeply") from None


def parse_expression(text: str, name: str, program: ir.Program, variables: ir.Names) -> ir.Expression:
    """Return the typed expression of a text, which may use a program's types, and built-in functions.

    `name`: of the text in error messages; `variables`: the variables that the expression may use. Raises InputError:
    the first mistake, with its column; for a name that is not declared, those that are.
    """
    return _Parser(ShaderSource(text, (name,))).expression(program, variables)


class _Parser:
    def __init__(self, source: ShaderSource) -> None:
        self._tokens, places = tokens_of(source)
        self._error, self._checker, self._next = places.error, Checker(places), 0
        checker = self._checker
        self._program = ir.Program([], [], checker.functions, places, names=checker.scopes[0], types=checker.types)
        self._loops = 0

    def expression(self, program: ir.Program, variables: ir.Names) -> ir.Expression:
        self._checker.types, self._checker.scopes, self._checker.only_reads = program.types, [variables], True
        found = self._expression()
        if self._token.kind != "end":
            raise self.error_here("expected the end of the expression")
        return found

    def program(self) -> ir.Program:
        while self._token.kind != "end":
            self._global()
        checked = set[int]()
        for functions in self._program.functions.values():
            for function in functions:
                self._check_calls(function, [], checked)
        return self._program

    def _check_calls(self, function: ir.Function, path: list[ir.Function], checked: set[int]) -> None:
        for called, at in function.calls if id(function) not in checked else ():
            if called.body is None:
                raise self._error(f"{called.name} is called, but has no body", at)
            if called in path or called is function:
                raise self._error(f"{called.name} calls itself: recursion is outside of the subset", at)
            self._check_calls(called, [*path, function], checked)
        checked.add(id(function))

    # Tokens

    @property
    def _token(self) -> Token:
        return self._tokens[self._next]

    def _take(self) -> Token:
        self._next += 1
        return self._tokens[self._next - 1]

    def _accept(self, text: str) -> bool:
        if self._tokens[self._next][1] == text:
            self._next += 1
            return True
        return False

    def _expect(self, text: str) -> Token:
        token = self._tokens[self._next]
        if token.text != text:
            raise self.error_here(f"expected {text}")
        self._next += 1
        return token

    def _name(self) -> Token:
        if self._token.kind != "name":
            raise self.error_here("expected a name")
        return self._take()

    def error_here(self, what: str) -> InputError:
        """Return the error of the next token."""
        return self._error(what, self._token.at, self._token.text)

    # Declarations

    def _global(self) -> None:
        token = self._token
        if token.text == "layout":
            return self._layout()
        if token.text == "struct":
            return self._struct()
        if token.text == ";":
            self._take()
            return None
        qualifier = self._take().text if token.text in ("const", "shared", "precise") else ""
        kind, name = self._type(), self._name()
        if self._token.text == "(" and not qualifier:
            return self._function(kind, name)
        where = qualifier if qualifier in ("const", "shared") else "global"
        self._program.globals += self._declared(kind, name, where, qualifier == "precise")
        self._expect(";")
        return None

    def _layout(self) -> None:
        self._expect("layout")
        settings = self._settings()
        words = list[str]()
        while self._token.text not in ("{", ";") and not (words and words[-1] in ("uniform", "buffer")):
            words.append(self._name().text)
        if words == ["in"]:
            self._expect(";")
            x, y, z = (settings.get(f"local_size_{axis}", 1) for axis in "xyz")
            self._program.local_size = (x, y, z)
            return
        name, binding = self._name(), settings.get("binding", 0)
        if (kind := self._checker.types.get(name.text)) in SAMPLERS.values() and kind is not None:
            name = self._name()
            block = ir.Variable(name.text, kind, "sampler", name.at, binding)
            self._checker.declare(name.text, name.at, block)
        elif words[-1:] in (["uniform"], ["buffer"]) and ("std140" if words[-1] == "uniform" else "std430") in settings:
            kind = Type(name.text, fields=self._members())
            block = ir.Variable(name.text, kind, words[-1], name.at, binding, is_read_only="readonly" in words)
            whole = ir.Memory(kind, name.at, block, 0, ())
            if self._token.kind == "name":
                instance = self._take()
                self._checker.declare(instance.text, instance.at, whole)
            else:
                for field, _ in kind.fields:
                    member = self._checker.member(whole, Token("name", field, name.at))
                    assert isinstance(member, ir.Memory)
                    self._checker.declare(field, name.at, member)
        else:
            raise self._error("a layout outside of the subset", name.at, " ".join([*settings, *words]))
        self._program.blocks.append(block)
        self._expect(";")

    def _settings(self) -> dict[str, int]:
        found = {}
        self._expect("(")
        while True:
            name = self._name()
            value = self._constant_size() if self._accept("=") else 0
            found[name.text] = value
            if not self._accept(","):
                self._expect(")")
                return found

    def _constant_size(self) -> int:
        at, value = self._token.at, self._expression()
        if not isinstance(value, ir.Constant):
            raise self._error("this is not a constant", at)
        return int(value.value)

    def _struct(self) -> None:
        self._expect("struct")
        name = self._name()
        self._checker.check_name(name.text, name.at)
        self._checker.types[name.text] = self._checker.limited(Type(name.text, fields=self._members()), name.at)
        self._expect(";")

    def _members(self) -> tuple[tuple[str, Type], ...]:
        found: list[tuple[str, Type]] = []
        self._expect("{")
        while not self._accept("}"):
            kind = self._type()
            while True:
                name = self._name()
                self._checker.check_name(name.text, name.at)
                found.append((name.text, self._array(kind)))
                if not self._accept(","):
                    break
            self._expect(";")
        return tuple(found)

    def _type(self) -> Type:
        token = self._take()
        kind = self._checker.types.get(token.text)
        if kind is None:
            raise self._error("expected a type", token.at, token.text)
        return kind

    def _array(self, kind: Type) -> Type:
        if not self._accept("["):
            return kind
        if self._accept("]"):
            return array_of(kind, 0)
        at, size = self._token.at, self._expression()
        self._expect("]")
        return self._checker.array(kind, size, at)

    def _function(self, result: Type, name: Token) -> None:
        checker, parameters = self._checker, list[ir.Variable]()
        self._expect("(")
        more = not self._accept(")")
        if more and self._accept("void"):
            more = False
            self._expect(")")
        while more:
            words = list[str]()
            while self._token.text in DIRECTIONS:
                words.append(self._take().text)
            kind, parameter = self._type(), self._name()
            if self._token.text == "[":
                raise self.error_here("an array as a parameter is outside of the subset")
            direction = next((word for word in words if word in ("in", "out", "inout")), "in")
            parameters.append(ir.Variable(parameter.text, kind, direction, parameter.at))
            if more := not self._accept(")"):
                self._expect(",")
        function = checker.function_of(name.text, result, parameters, name.at)
        if self._accept(";"):
            return
        if function.body is not None:
            raise self._error(f"{name.text} is defined twice", name.at)
        function.parameters, checker.function = parameters, function
        checker.open()
        for variable in parameters:
            checker.declare(variable.name, variable.at, variable)
        function.body = self._block(is_scope=False)
        if result is not VOID and not _returns(function.body):
            raise self._error(f"{name.text} may end without a value", name.at)
        checker.close()
        checker.function = None

    def _declared(self, kind: Type, name: Token, where: str, is_precise: bool = False) -> list[ir.Declare]:
        """Variables of one declaration; the first name is read already."""
        checker, found = self._checker, list[ir.Declare]()
        while True:
            of, value = self._array(kind), None
            if of is VOID or of in SAMPLERS.values() or (of.is_array and not of.size):
                raise self._error(f"a variable of type {of.name}", name.at)
            variable = ir.Variable(name.text, of, where, name.at, is_precise=is_precise)
            if self._accept("="):
                value = checker.converted(self._expression(), of, name.at)
            elif where == "const":
                raise self._error("a constant without a value", name.at, name.text)
            if where == "const" and isinstance(value, ir.Constant):
                variable.constant = value.value
            checker.declare(name.text, name.at, variable)
            found.append(ir.Declare(name.at, variable, value))
            if not self._accept(","):
                return found
            name = self._name()

    # Statements

    def _block(self, is_scope: bool = True) -> ir.Block:
        """Statements in braces; those of functions and of loops have the scope of their parameters."""
        at, statements = self._expect("{").at, list[ir.Statement]()
        if is_scope:
            self._checker.open()
        while not self._accept("}"):
            statements.append(self._statement())
        if is_scope:
            self._checker.close()
        return ir.Block(at, statements)

    def _statement(self) -> ir.Statement:
        token = self._token
        match token.text:
            case "{":
                return self._block()
            case ";":
                self._take()
                return ir.Block(token.at, [])
            case "if":
                self._take()
                condition = self._condition()
                then = self._scoped()
                return ir.If(token.at, condition, then, self._scoped() if self._accept("else") else None)
            case "for" | "while":
                return self._loop(self._take())
            case "break" | "continue" | "return":
                return self._leave(self._take())
        statement = self._simple()
        self._expect(";")
        return statement

    def _scoped(self) -> ir.Statement:
        self._checker.open()
        statement = self._statement()
        self._checker.close()
        return statement

    def _simple(self) -> ir.Statement:
        """Declaration or expression, without the semicolon."""
        token = self._token
        is_type = token.text in self._checker.types and self._tokens[self._next + 1].text != "("
        if token.text not in ("const", "precise") and not is_type:
            return ir.Evaluate(token.at, self._expression(True))
        words = set[str]()
        while self._token.text in ("const", "precise"):
            words.add(self._take().text)
        where = "const" if "const" in words else "local"
        found = self._declared(self._type(), self._name(), where, "precise" in words)
        found[0].at = token.at
        return found[0] if len(found) == 1 else ir.Block(token.at, list(found))

    def _condition(self) -> ir.Expression:
        at = self._expect("(").at
        condition = self._checker.converted(self._expression(True), BOOL, at, "the condition")
        self._expect(")")
        return condition

    def _loop(self, word: Token) -> ir.Loop:
        self._checker.open()
        begin = condition = step = None
        if word.text == "while":
            condition = self._condition()
        else:
            self._expect("(")
            begin = None if self._token.text == ";" else self._simple()
            at = self._expect(";").at
            if self._token.text != ";":
                condition = self._checker.converted(self._expression(True), BOOL, at, "the condition")
            self._expect(";")
            step = None if self._token.text == ")" else self._expression(True)
            self._expect(")")
        self._loops += 1
        body = self._block(is_scope=False) if self._token.text == "{" else self._scoped()
        self._loops -= 1
        self._checker.close()
        return ir.Loop(word.at, begin, condition, step, body)

    def _leave(self, word: Token) -> ir.Leave:
        value = None
        if word.text != "return" and not self._loops:
            raise self._error(f"{word.text} outside of a loop", word.at)
        if word.text == "return" and self._token.text != ";":
            value = self._expression()
        self._expect(";")
        assert self._checker.function is not None
        result = self._checker.function.result
        if word.text == "return" and (value is None) != (result is VOID):
            raise self._error(
                "return with a value of another type", word.at, "no value" if value is None else "a value"
            )
        if value is not None:
            value = self._checker.converted(value, result, word.at)
        return ir.Leave(word.at, word.text, value)

    # Expressions

    def _expression(self, may_assign: bool = False) -> ir.Expression:
        left = self._binary(1)
        token = self._token
        if token.text == "?":
            self._take()
            a = self._expression()
            self._expect(":")
            left = self._checker.choice(left, a, self._expression(), token.at)
        if token.text in ASSIGNMENTS:
            if not may_assign:
                raise self._error("an assignment inside of an expression", token.at)
            self._take()
            return self._checker.assign(left, token.text, self._expression(True), token.at)
        return left

    def _binary(self, level: int) -> ir.Expression:
        left = self._unary()
        while (found := PRECEDENCE.get(self._tokens[self._next].text, 0)) >= level:
            sign = self._take()
            left = self._checker.binary(sign.text, left, self._binary(found + 1), sign.at)
        return left

    def _unary(self) -> ir.Expression:
        token = self._token
        if token.kind == "sign":
            if token.text in ("-", "+", "!", "~"):
                self._take()
                return self._checker.unary(token.text, self._unary(), token.at)
            if token.text in ("++", "--"):
                self._take()
                return self._counted(self._unary(), token, False)
        return self._postfix()

    def _counted(self, target: ir.Expression, sign: Token, gives_old: bool) -> ir.Assign:
        one = ir.Constant(INT, sign.at, 1) if target.type.element in ("i", "u") else ir.Constant(FLOAT, sign.at, 1.0)
        return self._checker.assign(target, sign.text[0] + "=", one, sign.at, gives_old)

    def _postfix(self) -> ir.Expression:
        value = self._primary()
        while True:
            token = self._token
            if token.text == ".":
                self._take()
                if (name := self._name()).text == "length" and self._accept("("):
                    self._expect(")")
                    value = self._checker.length(value, name.at)
                else:
                    value = self._checker.member(value, name)
            elif token.text == "[":
                self._take()
                index = self._expression()
                self._expect("]")
                value = self._checker.element(value, index, token.at)
            elif token.text in ("++", "--"):
                value = self._counted(value, self._take(), True)
            else:
                return value

    def _primary(self) -> ir.Expression:
        token = self._take()
        if token.kind == "number":
            try:
                return _number(token)
            except ValueError:
                raise self._error("no such number of 32 bits", token.at, token.text) from None
        if token.text == "(":
            value = self._expression()
            self._expect(")")
            return value
        if token.text in ("true", "false"):
            return ir.Constant(BOOL, token.at, token.text == "true")
        if token.kind != "name":
            raise self._error("expected an expression", token.at, token.text)
        if self._token.text != "(":
            return self._checker.value_of(token)
        self._take()
        arguments: list[ir.Expression] = []
        more = not self._accept(")")
        while more:
            arguments.append(self._expression())
            if more := not self._accept(")"):
                self._expect(",")
        return self._checker.call(token, arguments)


def _returns(node: ir.Statement | None) -> bool:
    """Return whether what follows a statement is never reached, as it returns or goes on for ever."""
    if isinstance(node, ir.Block):
        return any(_returns(one) for one in node.statements)
    if isinstance(node, ir.If):
        return _returns(node.then) and _returns(node.otherwise)
    return (isinstance(node, ir.Loop) and node.condition is None) or (
        isinstance(node, ir.Leave) and node.kind == "return"
    )


def _number(token: Token) -> ir.Constant:
    text = token.text.lower()
    if text.startswith("0x") or text.rstrip("u").isdigit():
        digits, kind = text.rstrip("u"), UINT if text.endswith("u") else INT
        if (value := int(digits, 8 if len(digits) > 1 and digits.isdigit() and digits[0] == "0" else 0)) >> 32:
            raise ValueError
        return ir.Constant(kind, token.at, whole(kind.element, value))
    return ir.Constant(DOUBLE if text.endswith("lf") else FLOAT, token.at, float(text.rstrip("lf")))
