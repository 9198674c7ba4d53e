function [force, m] = quintic(p, m, from, to, v)
% Spring c y^5.
force = p(1) * to^5;
end
