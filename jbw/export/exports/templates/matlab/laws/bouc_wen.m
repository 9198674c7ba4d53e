function [force, m] = bouc_wen(p, m, from, to, v)
% Bouc-Wen's law with nu = 1; remembers its force.
m(1) = bouc_wen_moved(p, m(1), to - from);
force = m(1);
end
