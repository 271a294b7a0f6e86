// Nothing is cut away.
void cut(inout Ray ray) {}
