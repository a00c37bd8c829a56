// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {CommonBase} from "forge-std/Base.sol";
import {StdUtils} from "forge-std/StdUtils.sol";
import {Vm} from "forge-std/Vm.sol";
import {IECoin} from "../../src/IECoin.sol";
import {Organization} from "../../src/Organization.sol";
import {ServiceManager} from "../../src/ServiceManager.sol";
import {TaskManager} from "../../src/TaskManager.sol";
import {IMatchingPolicy} from "../../src/interfaces/IMatchingPolicy.sol";
import {Finding, IJudge} from "../../src/interfaces/IJudge.sol";
import {Kind, MAX_RULES, Windows} from "../../src/interfaces/IOrganization.sol";
import {MAX_SERVICES, Service, ServiceState} from "../../src/interfaces/IServiceManager.sol";
import {IProviders, Outcome, Terms} from "../../src/interfaces/IProviders.sol";
import {
    Fault,
    Hire,
    ITaskManager,
    Ruling,
    Standing,
    Task,
    TaskRequest,
    TaskState
} from "../../src/interfaces/ITaskManager.sol";
import {ISignedRequests} from "../../src/interfaces/ISignedRequests.sol";
import {RoleJudge} from "../../src/judges/RoleJudge.sol";
import {KindId} from "../../src/types/KindId.sol";
import {NO_SERVICE, ServiceId, unpackService} from "../../src/types/ServiceId.sol";
import {NO_TASK, TaskId} from "../../src/types/TaskId.sol";
import {Numbers} from "../Fixture.sol";
import {Possession} from "../Possession.sol";
import {Signing} from "../Signing.sol";

/// @notice What a service agreed to and what should be left of it, from the rules alone.
struct Ghost {
    uint256 bond;
    uint256 penalty;
    uint256 maxFailures;
    bool suspended;
    bool autoAccept;
}

/// @notice What others paid a provider for, and what it failed, in billionths of a unit, as of `day`.
struct Work {
    uint256 done;
    uint256 failed;
    uint256 day;
    /// @dev Whose attempt counted last, and when, but for the organization's.
    address creator;
    uint256 since;
}

/// @notice Who judges a kind, and by which rules: the newest last.
struct Judged {
    IJudge judge;
    bytes32[] rules;
}

/// @notice Everything that anyone can do at any time, with bounded arguments, and what it should do to balances,
/// bonds and standing.
contract Handler is CommonBase, StdUtils, Numbers {
    bytes32 private constant CLEANING = "waste_disposal";
    bytes32 private constant CHARGING = "battery_charging";
    /// @dev So many different rules are named; more than may be current.
    uint256 private constant RULES = 12;
    /// @dev Services of a line, and tasks of a queue, at which a match looks.
    uint256 private constant MAX_LOOKS = 4;
    uint256 private constant NO_LIMIT = type(uint256).max;
    bytes32 private constant PROOF = "relayed";
    uint8 private constant ACCEPTED = 1;

    IECoin private immutable _coin;
    Organization private immutable _organization;
    ServiceManager private immutable _services;
    IProviders private immutable _records;
    TaskManager private immutable _tasks;
    RoleJudge private immutable _oracles;
    RoleJudge private immutable _auditors;
    address private immutable _admin;
    address private immutable _oracle;
    address private immutable _auditor;
    address[] private _creators;
    address[] private _providers;
    IMatchingPolicy[] private _policies;

    /// @notice What each participant should own, from its own calls and the rules alone.
    mapping(address participant => uint256) public expected;
    mapping(ServiceId serviceId => Ghost) public ghost;
    /// @notice What the rules forbid and happened nevertheless; empty if nothing did.
    string public violation;

    /// @notice Attempts that a provider let pass without a proof since the last accepted one.
    mapping(address provider => uint256) public missed;
    /// @notice Failures in a row of all services of a provider.
    mapping(address provider => uint256) public failures;
    mapping(address provider => uint256) private _naps;
    mapping(address provider => Work) private _work;
    mapping(address device => address) private _owners;
    /// @dev Whom a provider has named; 0 for itself.
    mapping(address provider => address) private _payouts;
    /// @dev How often its signature was used.
    mapping(address device => uint256) private _signatures;
    /// @notice When a provider that is asleep may wake up; 0 while it is awake.
    mapping(address provider => uint256) public asleepUntil;
    /// @dev The providers that had a task and did not do it, in attempts that do not count.
    mapping(TaskId taskId => address[]) private _passed;
    mapping(TaskId taskId => bool) private _gaveUp;
    mapping(address provider => bool) private _suspended;
    /// @dev Attempts that their executor accepted by a call.
    mapping(TaskId taskId => mapping(uint8 attempt => bool)) private _accepted;
    mapping(TaskId taskId => uint8) private _attemptSeen;
    /// @dev The service that the task names.
    mapping(TaskId taskId => ServiceId) private _hired;
    /// @dev The provider that the task names.
    mapping(TaskId taskId => address) private _hiredFrom;
    /// @dev The attempt that the oracle has passed on last.
    mapping(TaskId taskId => uint8) private _passedOn;
    /// @dev What the judge said last, and nobody has concluded.
    mapping(TaskId taskId => Standing) private _standing;
    /// @dev As it was when the task was posted.
    mapping(TaskId taskId => uint256) private _auditWindow;
    mapping(bytes32 kind => Judged) private _judged;
    mapping(address creator => mapping(uint256 nonce => bool)) private _usedNonces;

    /// @dev After every call: whoever was assigned was next in line. Of the tasks that name nobody the last policy, which is
    /// unruly, chooses any.
    modifier inOrder() {
        _;
        bool unruly = _organization.policy() == _policies[_policies.length - 1];
        uint256 count = _tasks.taskCount();
        for (uint256 number = 1; number <= count; ++number) {
            TaskId taskId = taskNo(number);
            Task memory t = _tasks.task(taskId);
            if (t.attempt == _attemptSeen[taskId]) continue;
            _attemptSeen[taskId] = t.attempt;
            if (t.state != TaskState.Assigned) continue;
            if (_hired[taskId] != NO_SERVICE && _hired[taskId] != t.serviceId) {
                violation = "another service was hired";
            }
            address provider = _services.providerOf(t.serviceId);
            if (_hiredFrom[taskId] != address(0) && _hiredFrom[taskId] != provider) {
                violation = "another provider was hired";
            }
            uint256 own = _services.service(t.serviceId).price;
            if (t.price != own) violation = "a service is paid another price";
            if (t.price > t.reward) violation = "a price is above the reward";
            uint256 looks = 0;
            for (TaskId older = taskNo(1); older < taskId; older = following(older)) {
                Task memory o = _tasks.task(older);
                if (o.state != TaskState.Open || o.reward < own) continue;
                if (_hasPassed(older, provider)) {
                    // A match looks at four.
                    if (++looks == 4) break;
                    continue;
                }
                bool mayTake = _hired[older] == NO_SERVICE && _hiredFrom[older] == address(0) && !unruly;
                if (mayOverlook(older, provider)) mayTake = false;
                if (_hired[older] == t.serviceId || _hiredFrom[older] == provider) mayTake = true;
                if (mayTake) violation = "a task was overtaken";
            }
        }
    }

    constructor(
        IECoin coin,
        Organization organization,
        address admin,
        address oracle,
        address auditor,
        address[] memory creators,
        address[] memory providers,
        IMatchingPolicy[] memory policies
    ) {
        (_coin, _organization, _admin, _oracle, _auditor) = (coin, organization, admin, oracle, auditor);
        _services = ServiceManager(address(organization.services()));
        _records = _services.providers();
        _tasks = TaskManager(address(organization.tasks()));
        KindId number = organization.numberOf(CLEANING);
        _oracles = RoleJudge(address(organization.judgeNumbered(number)));
        _auditors = RoleJudge(address(organization.auditors()));
        (_creators, _providers, _policies) = (creators, providers, policies);
        for (uint256 i = 0; i < creators.length; ++i) {
            expected[creators[i]] = coin.balanceOf(creators[i]);
        }
        for (uint256 i = 0; i < providers.length; ++i) {
            expected[providers[i]] = coin.balanceOf(providers[i]);
        }
        expected[address(organization)] = coin.balanceOf(address(organization));
        _judged[CLEANING] = Judged(_oracles, organization.currentRules(CLEANING));
        _judged[CHARGING] = Judged(_oracles, organization.currentRules(CHARGING));
    }

    /// @notice In 64ths, from what was judged and paid alone.
    function reputation(address provider) external view returns (uint256) {
        Work memory w = _workOf(provider);
        return (w.done + 100 ether) * 64 / (w.done + w.failed + 200 ether);
    }

    /// @dev Day by day.
    function _workOf(address provider) private view returns (Work memory w) {
        w = _work[provider];
        for (uint256 today = block.timestamp / 1 days; w.day < today; ++w.day) {
            (w.done, w.failed) = (w.done * 992_327_942 / 1e9, w.failed * 992_327_942 / 1e9);
            if (w.done + w.failed == 0) w.day = today - 1;
        }
    }

    /// @dev The work for its creator was judged, or never came: at most the reference price counts, and once a day in a row.
    function _expectReputation(Task memory t, uint256 done, uint256 failed) private {
        address provider = _services.providerOf(t.serviceId);
        // Less than a unit of prices is nothing.
        if (_isOwn(t.creator, provider) || done + failed < 1 gwei) return;
        Work memory w = _workOf(provider);
        uint256 most = _organization.referencePriceOf(_organization.kindNumbered(t.kindId));
        (done, failed) = (_min(done, most), _min(failed, most));
        if (t.creator != address(_organization)) {
            bool again = w.creator == t.creator && w.since == block.timestamp / 1 days;
            if (again) return;
            (w.creator, w.since) = (t.creator, block.timestamp / 1 days);
        }
        (w.done, w.failed) = (w.done + done, w.failed + failed);
        _work[provider] = w;
    }

    /// @dev The creator, or its owner, does the work or is paid for it.
    function _isOwn(address creator, address provider) private view returns (bool) {
        address payer = _principal(creator);
        return payer == _principal(provider) || payer == _payoutOf(provider);
    }

    function _payoutOf(address provider) private view returns (address) {
        return _payouts[provider] == address(0) ? provider : _payouts[provider];
    }

    function _principal(address account) private view returns (address) {
        return _owners[account] == address(0) ? account : _owners[account];
    }

    /// @notice What the administrator has made current, and nobody has retired; the newest last.
    function expectedRules(bytes32 kind) external view returns (bytes32[] memory) {
        return _judged[kind].rules;
    }

    // -- creators -----------------------------------------------------------------------------------------

    function registerTask(uint256 who, uint256 reward, uint8 attempts, uint256 wish) external inOrder {
        address creator = _creators[bound(who, 0, _creators.length - 1)];
        reward = bound(reward, 0, _min(expected[creator], 200 ether));
        attempts = uint8(bound(attempts, 1, 3));
        // Three in four leave it to the organization.
        bytes32 wanted = wish % 4 == 0 ? _rulesAt(wish / 4) : bytes32(0);
        bytes32[] memory current = _judged[CLEANING].rules;
        TaskRequest memory request = TaskRequest(
            CLEANING, reward, 1 hours, 1 hours, attempts, wanted, _named(wish), _namedProvider(wish), "{}"
        );
        if (wanted != 0 && !_isCurrent(current, wanted)) {
            vm.prank(creator);
            try _tasks.registerTask(request) {
                violation = "a task was posted under rules that are not current";
            } catch {}
            return;
        }
        request.verdictWindow = _verdictWindow(wish);
        Kind memory k = _organization.kindOf(CLEANING);
        bool right =
            request.verdictWindow >= k.minVerdictWindow && request.verdictWindow <= k.maxVerdictWindow;
        vm.recordLogs();
        vm.prank(creator);
        try _tasks.registerTask(request) {
            if (!right) violation = "a verdict window was too short or too long";
        } catch {
            // Whoever has no service left cannot be named.
            if (right && (request.provider == address(0) || _live(request.provider) != 0)) {
                violation = "a task could not be posted";
            }
            return;
        }
        expected[creator] -= reward;
        _hired[taskNo(_tasks.taskCount())] = unpackService(request.serviceId);
        _hiredFrom[taskNo(_tasks.taskCount())] = request.provider;
        _auditWindow[taskNo(_tasks.taskCount())] = k.auditWindow;
        if (_rulesPosted() != (wanted == 0 ? current[current.length - 1] : wanted)) {
            violation = "a task was posted under other rules";
        }
    }

    /// @dev Two tasks in five name a service.
    function _named(uint256 wish) private view returns (uint32) {
        uint256 count = _services.serviceCount();
        return count == 0 || wish % 5 > 1 ? 0 : uint32(1 + (wish / 5) % count);
    }

    /// @dev Another one in five names a provider, if possible one with several services: any of them may do the task.
    function _namedProvider(uint256 wish) private view returns (address) {
        if (wish % 5 != 2) return address(0);
        uint256 first = wish / 5;
        for (uint256 i = 0; i < _providers.length; ++i) {
            address provider = _providers[(first + i) % _providers.length];
            if (_live(provider) > 1) return provider;
        }
        return _providers[first % _providers.length];
    }

    /// @dev One in eight is none in which anybody should agree to work.
    function _verdictWindow(uint256 wish) private pure returns (uint32) {
        if (wish % 8 == 5) return 1 minutes;
        return wish % 8 == 6 ? 30 days : 1 hours;
    }

    /// @dev As the event of the task that was just posted tells.
    function _rulesPosted() private returns (bytes32 rules) {
        Vm.Log[] memory logs = vm.getRecordedLogs();
        for (uint256 i = 0; i < logs.length; ++i) {
            if (logs[i].topics[0] == ITaskManager.TaskRegistered.selector) {
                (,,,, rules,) = abi.decode(logs[i].data, (uint256, uint32, uint32, uint8, bytes32, string));
            }
        }
    }

    /// @dev Creators try at any time; the rules give the reward back only while the task is open.
    function cancelTask(uint256 which) external inOrder {
        TaskId taskId = taskNo(_any(which));
        if (taskId == NO_TASK) return;
        Task memory t = _tasks.task(taskId);
        vm.prank(t.creator);
        try _tasks.cancelTask(taskId) {
            if (t.state == TaskState.Open) expected[t.creator] += t.reward;
        } catch {
            if (t.state == TaskState.Open) violation = "an open task could not be cancelled";
        }
    }

    /// @dev A nonce that nobody uses up or revokes.
    uint256 private constant UNUSED = type(uint256).max;

    /// @dev Whoever relays it: the creator pays, once, what it signed, and nothing where anything is wrong with it.
    function relayTask(uint256 who, uint256 reward, uint256 nonce, uint256 flaw) external inOrder {
        address creator = _creators[bound(who, 0, _creators.length - 1)];
        reward = bound(reward, 0, _min(expected[creator], 200 ether));
        nonce = bound(nonce, 0, 9);
        ISignedRequests requests = ISignedRequests(_tasks.signedRequests());
        bool right = !_usedNonces[creator][nonce];
        TaskRequest memory request =
            TaskRequest(CLEANING, reward, 1 hours, 1 hours, 3, 0, 0, address(0), "{}");
        uint256 deadline = block.timestamp + 1 hours;
        // Half of them are as they should be.
        flaw = bound(flaw, 0, 7);
        address key = flaw == 1 ? _creators[(who % _creators.length + 1) % _creators.length] : creator;
        if (flaw == 2) deadline = block.timestamp - 1;
        bytes memory signature =
            Signing.registration(Possession.keyOf(key), address(requests), creator, request, nonce, deadline);
        if (flaw == 3) request.maxAttempts = 2;
        right = right && key == creator && flaw != 2 && flaw != 3;
        try requests.registerTaskFor(creator, request, nonce, deadline, signature) {
            if (!right) violation = "a request counted that should not";
            expected[creator] -= reward;
            _auditWindow[taskNo(_tasks.taskCount())] = _organization.kindOf(CLEANING).auditWindow;
            if (_tasks.task(taskNo(_tasks.taskCount())).creator != creator) {
                violation = "a relayer is the creator";
            }
            _usedNonces[creator][nonce] = true;
        } catch {
            if (right) violation = "a task could not be relayed";
        }
    }

    /// @dev By its executor, and before by others, for other work, and too late.
    function relayProof(uint256 which) external inOrder {
        TaskId taskId = _find(which, TaskState.Assigned);
        if (taskId == NO_TASK) return;
        Task memory t = _tasks.task(taskId);
        if (block.timestamp > t.deadline) return;
        address executor = _services.providerOf(t.serviceId);
        uint256 end = block.timestamp;
        if (_relayProof(executor, _creators[0], taskId, t.attempt, PROOF, end)) {
            violation = "anybody signs proofs";
        }
        if (_relayProof(_creators[0], _creators[0], taskId, t.attempt, PROOF, end)) {
            violation = "another one's proof was taken";
        }
        if (_relayProof(executor, executor, taskId, t.attempt, "another", end)) {
            violation = "another proof was taken than was signed";
        }
        if (_relayProof(executor, executor, taskId, t.attempt, PROOF, end - 1)) {
            violation = "a proof was relayed too late";
        }
        if (!_relayProof(executor, executor, taskId, t.attempt, PROOF, end)) {
            violation = "a proof could not be relayed";
        }
    }

    /// @dev With a signature of `key` on PROOF.
    function _relayProof(
        address executor,
        address key,
        TaskId taskId,
        uint8 attempt,
        bytes32 proofHash,
        uint256 deadline
    ) private returns (bool) {
        ISignedRequests requests = ISignedRequests(_tasks.signedRequests());
        bytes memory signature = Signing.proof(
            Possession.keyOf(key), address(requests), executor, taskId, attempt, PROOF, "", UNUSED, deadline
        );
        try requests.submitProofFor(executor, taskId, attempt, proofHash, "", UNUSED, deadline, signature) {
            return true;
        } catch {
            return false;
        }
    }

    /// @dev The task comes back to its creator, who signed that, and to nobody else's wish.
    function relayCancellation(uint256 which, uint256 who) external inOrder {
        TaskId taskId = taskNo(_any(which));
        if (taskId == NO_TASK) return;
        Task memory t = _tasks.task(taskId);
        address key = _creators[bound(who, 0, _creators.length - 1)];
        ISignedRequests requests = ISignedRequests(_tasks.signedRequests());
        bytes memory signature = Signing.cancellation(
            Possession.keyOf(key), address(requests), t.creator, taskId, UNUSED, block.timestamp
        );
        bool right = key == t.creator && t.state == TaskState.Open;
        try requests.cancelTaskFor(t.creator, taskId, UNUSED, block.timestamp, signature) {
            if (!right) violation = "a task was cancelled that its creator did not cancel";
            expected[t.creator] += t.reward;
        } catch {
            if (right) violation = "a cancellation could not be relayed";
        }
    }

    // -- providers ----------------------------------------------------------------------------------------

    function registerService(uint256 who, uint256 price, bool autoAccept) external inOrder {
        address provider = _providers[bound(who, 0, _providers.length - 1)];
        Terms memory terms = _organization.terms();
        if (_services.serviceCount() >= 12 || expected[provider] < terms.bond) return;
        if (terms.bond != 0) {
            vm.prank(provider);
            try _services.registerService(CLEANING, 0, terms.bond - 1, true, "") {
                violation = "a bond was taken that nobody agreed to";
            } catch {}
        }
        vm.prank(provider);
        try _services.registerService(CLEANING, _price(price), NO_LIMIT, autoAccept, "") returns (
            ServiceId serviceId
        ) {
            if (_suspended[provider]) violation = "a suspended provider offered a service";
            expected[provider] -= terms.bond;
            ghost[serviceId] = Ghost(terms.bond, terms.penalty, terms.maxFailures, false, autoAccept);
        } catch {
            bool right = _live(provider) < MAX_SERVICES && asleepUntil[provider] == 0 && !_suspended[provider];
            if (right) violation = "a service could not be offered";
            return;
        }
    }

    /// @dev A provider that offers as many services as it can; once in a run, else nobody else would get a task.
    function hoard(uint256 who) external inOrder {
        address provider = _providers[bound(who, 0, _providers.length - 1)];
        Terms memory terms = _organization.terms();
        if (_services.serviceCount() > 2 || terms.bond != 0) return;
        for (uint256 i = 0; i <= MAX_SERVICES; ++i) {
            vm.prank(provider);
            try _services.registerService(CLEANING, 0, 0, true, "") returns (ServiceId serviceId) {
                ghost[serviceId] = Ghost(0, 0, terms.maxFailures, false, true);
            } catch {}
        }
        if (_live(provider) > MAX_SERVICES) violation = "a provider has too many services";
    }

    /// @dev Services of a provider that take tasks, will, or do one.
    function _live(address provider) private view returns (uint256 count) {
        for (ServiceId serviceId = serviceNo(1); _exists(serviceId); serviceId = following(serviceId)) {
            Service memory s = _services.service(serviceId);
            if (s.provider == provider && (s.state != ServiceState.Retired || s.taskId != NO_TASK)) ++count;
        }
    }

    function updateService(uint256 which, uint256 price, uint8 state) external inOrder {
        ServiceId serviceId = serviceNo(_anyService(which));
        if (serviceId == NO_SERVICE) return;
        Service memory s = _services.service(serviceId);
        if (s.state == ServiceState.Retired) return;
        // One in ten retires, else there would soon be no service left.
        ServiceState next = state % 10 == 0 ? ServiceState.Retired : ServiceState(1 + state % 2);
        // Every other time whoever is paid tries, who may only retire it.
        bool right = price % 2 == 0 || _payoutOf(s.provider) == s.provider || next == ServiceState.Retired;
        vm.prank(price % 2 == 0 ? s.provider : _payoutOf(s.provider));
        try _services.updateService(serviceId, _price(price), next) {
            if (!right) violation = "whoever is paid changed a service";
            if (asleepUntil[s.provider] != 0 && next == ServiceState.Active) violation = "an update woke";
            if (next == ServiceState.Active && _isShort(serviceId)) violation = "a bond secures two tasks";
            if (ghost[serviceId].suspended && next != ServiceState.Retired) violation = "left a suspension";
            if (next == ServiceState.Retired) {
                ghost[serviceId].suspended = false;
                if (s.taskId == NO_TASK) _expectBondBack(serviceId, s.provider);
            }
        } catch {
            bool able = asleepUntil[s.provider] == 0 && !_isShort(serviceId);
            bool may = !ghost[serviceId].suspended && (next != ServiceState.Active || able);
            if (right && (may || next == ServiceState.Retired)) violation = "locked in";
        }
    }

    /// @dev What is left of the bond does not cover a penalty.
    function _isShort(ServiceId serviceId) private view returns (bool) {
        return ghost[serviceId].bond < ghost[serviceId].penalty;
    }

    /// @dev Anybody says who is paid for a provider's work, and is believed where it is paid itself.
    function setPayout(uint256 who, uint256 whose, uint256 next) external {
        address provider = _providers[bound(whose, 0, _providers.length - 1)];
        // Every fourth time whoever may, else hardly any change would come about.
        address caller = who % 4 == 0 ? _payoutOf(provider) : _participant(who / 4);
        address payout = _participant(next);
        vm.prank(caller);
        try _records.setPayout(provider, payout) {
            if (caller != _payoutOf(provider)) violation = "payments were redirected";
            _payouts[provider] = payout == provider ? address(0) : payout;
        } catch {
            if (caller == _payoutOf(provider)) violation = "payments could not be redirected";
        }
    }

    function _participant(uint256 which) private view returns (address) {
        which %= _creators.length + _providers.length;
        return which < _creators.length ? _creators[which] : _providers[which - _creators.length];
    }

    function wakeUp(uint256 who) external inOrder {
        address provider = _providers[bound(who, 0, _providers.length - 1)];
        uint256 until = asleepUntil[provider];
        bool right = until != 0 && block.timestamp >= until;
        vm.prank(provider);
        try _services.wakeUp() {
            if (!right) violation = "a provider woke up too early";
            (missed[provider], asleepUntil[provider]) = (0, 0);
        } catch {
            if (right) violation = "a provider could not wake up";
        }
    }

    function acceptTask(uint256 which) external inOrder {
        TaskId taskId = _find(which, TaskState.Assigned);
        if (taskId == NO_TASK) return;
        Task memory t = _tasks.task(taskId);
        if (block.timestamp > t.deadline) return;
        bool again = _hasAccepted(taskId, t);
        vm.prank(_services.providerOf(t.serviceId));
        try _tasks.acceptTask(taskId, t.attempt) {
            if (again) violation = "a task was accepted twice";
            _accepted[taskId][t.attempt] = true;
        } catch {
            if (!again) violation = "a task could not be accepted";
        }
    }

    /// @dev At any time while it is assigned; it costs something only late, and who had accepted it.
    function abandonTask(uint256 which, uint256 time) external inOrder {
        TaskId taskId = _find(which, TaskState.Assigned);
        if (taskId == NO_TASK) return;
        Task memory t = _tasks.task(taskId);
        if (block.timestamp > t.deadline) return;
        vm.warp(bound(time, block.timestamp, t.deadline));
        bool blamed = block.timestamp > _graceEnd(t) && _hasAccepted(taskId, t);
        vm.prank(_services.providerOf(t.serviceId));
        _tasks.abandonTask(taskId, t.attempt);
        _expectFailure(taskId, t, blamed);
    }

    /// @notice Whether a match, which looks at few services and few tasks, may not have seen that both fit: so many services are
    /// of providers that the task has passed, or so many tasks have passed the provider.
    function mayOverlook(TaskId taskId, address provider) public view returns (bool) {
        (uint256 count, uint256 tasks) = (0, 0);
        for (ServiceId serviceId = serviceNo(1); _exists(serviceId); serviceId = following(serviceId)) {
            if (_hasPassed(taskId, _services.providerOf(serviceId))) ++count;
        }
        for (TaskId id = taskNo(1); _exists(id); id = following(id)) {
            if (_hasPassed(id, provider)) ++tasks;
        }
        return count >= MAX_LOOKS || tasks >= MAX_LOOKS;
    }

    function _hasPassed(TaskId taskId, address provider) private view returns (bool) {
        for (uint256 i = 0; i < _passed[taskId].length; ++i) {
            if (_passed[taskId][i] == provider) return true;
        }
        return false;
    }

    /// @dev An attempt is over, of those that count the last one.
    function _isLast(TaskId taskId, Task memory t) private view returns (bool) {
        return t.attempt - _passed[taskId].length == t.maxAttempts;
    }

    /// @dev Tasks that their creator does itself, after others gave them back: that shows nothing about the others.
    function giveBackOwn() external {
        address creator = _creators[_creators.length - 1]; // a provider, too
        for (uint256 i = 0; i < 4; ++i) {
            this.registerTask(_creators.length - 1, 200 ether, 3, 3);
            TaskId taskId = taskNo(_tasks.taskCount());
            if (taskId == NO_TASK) return;
            Task memory t = _tasks.task(taskId);
            while (
                t.state == TaskState.Assigned && block.timestamp <= _graceEnd(t)
                    && _services.providerOf(t.serviceId) != creator
            ) {
                this.abandonTask(TaskId.unwrap(taskId) - 1, block.timestamp);
                t = _tasks.task(taskId);
            }
            this.submitProof(TaskId.unwrap(taskId) - 1, "");
            this.rule(TaskId.unwrap(taskId) - 1, ACCEPTED, NO_LIMIT);
        }
    }

    /// @dev A provider that gives back, at once, whatever it gets of a few tasks that others can do.
    function giveBack(uint256 who, uint256 which) external {
        address provider = _providers[bound(who, 0, _providers.length - 1)];
        for (uint256 i = 0; i < 4; ++i) {
            this.registerTask(which, 200 ether, 3, 3);
            for (TaskId taskId = taskNo(1); _exists(taskId); taskId = following(taskId)) {
                Task memory t = _tasks.task(taskId);
                if (t.state != TaskState.Assigned || block.timestamp > _graceEnd(t)) continue;
                if (_services.providerOf(t.serviceId) == provider) {
                    this.abandonTask(TaskId.unwrap(taskId) - 1, block.timestamp);
                }
            }
            this.submitProof(_tasks.taskCount() - 1, "");
            this.rule(_tasks.taskCount() - 1, ACCEPTED, NO_LIMIT);
        }
    }

    function _hasAccepted(TaskId taskId, Task memory t) private view returns (bool) {
        return ghost[t.serviceId].autoAccept || _accepted[taskId][t.attempt];
    }

    /// @dev A quarter of the execution window after the assignment.
    function _graceEnd(Task memory t) private pure returns (uint256) {
        return t.deadline - t.executionWindow * 3 / 4;
    }

    function submitProof(uint256 which, bytes32 proofHash) external inOrder {
        TaskId taskId = _find(which, TaskState.Assigned);
        if (taskId == NO_TASK) return;
        // A few only: the hash of another's proof stops nobody from submitting it.
        proofHash = keccak256(abi.encode(uint256(proofHash) % 4));
        Task memory t = _tasks.task(taskId);
        if (block.timestamp > t.deadline) return;
        vm.prank(_services.providerOf(t.serviceId));
        _tasks.submitProof(taskId, t.attempt, proofHash, "");
    }

    function replaceProof(uint256 which, bytes32 proofHash) external inOrder {
        TaskId taskId = _find(which, TaskState.Submitted);
        if (taskId == NO_TASK || proofHash == 0) return;
        Task memory t = _tasks.task(taskId);
        vm.prank(_services.providerOf(t.serviceId));
        try _tasks.submitProof(taskId, t.attempt, proofHash, "") {
            violation = "a proof was replaced";
        } catch {}
    }

    // -- judges -------------------------------------------------------------------------------------------

    /// @dev The oracle says something final, from submission to the end of the case, after it tried to speak of another
    /// proof. What it has passed on it does not decide.
    function rule(uint256 which, uint8 said, uint256 amount) public inOrder {
        TaskId taskId = _findJudged(which, amount);
        if (taskId == NO_TASK || block.timestamp > _caseEnd(taskId)) return;
        Task memory t = _tasks.task(taskId);
        Ruling ruling = _ruling(said);
        Finding memory f = _finding(taskId, t, ruling, _amount(t, ruling, amount));
        bytes32 proofHash = f.proofHash;
        f.proofHash = ~proofHash;
        _mustNot(_oracle, f, "a ruling on another proof counted");
        f.proofHash = proofHash;
        _mustNot(t.creator, f, "the creator is its oracle");
        _mustNot(_services.providerOf(t.serviceId), f, "the executor is its oracle");
        if (_passedOn[taskId] == t.attempt) {
            _mustNot(_oracle, f, "who could not decide decided");
            return;
        }
        if (bytes(violation).length != 0) return;
        vm.prank(_oracle);
        _oracles.rule(f, "");
        _expectFinal(taskId, t, ruling, f.amount);
    }

    /// @dev A judge whose ruling stands until a time that it says, and which replaces one that stands.
    function ruleUntil(uint256 which, uint8 said, uint256 amount, uint256 until) public inOrder {
        TaskId taskId = _findJudged(which, until);
        if (taskId == NO_TASK || block.timestamp >= _caseEnd(taskId)) return;
        Task memory t = _tasks.task(taskId);
        Ruling ruling = _ruling(said);
        Finding memory f = _finding(taskId, t, ruling, _amount(t, ruling, amount));
        uint256 end = _caseEnd(taskId);
        _mustNotStand(f, end + 1, "a case became longer");
        _mustNotStand(f, block.timestamp, "a ruling stands that can be concluded at once");
        if (bytes(violation).length != 0) return;
        until = bound(until, block.timestamp + 1, end);
        _stand(f, until);
        _expectStanding(taskId, t, ruling, f.amount, until);
    }

    /// @dev Work that is rejected, and then work that is accepted.
    function failAndSucceed(uint256 which) external {
        for (uint256 i = 0; i < 2; ++i) {
            this.submitProof(which, "");
            this.rule(which, i == 1 ? ACCEPTED : ACCEPTED + 1, 0);
        }
    }

    /// @dev The oracle cannot decide: the attempt is over for its service.
    function passOn(uint256 which) external inOrder {
        TaskId taskId = _findJudged(which, which);
        if (taskId == NO_TASK || block.timestamp >= _caseEnd(taskId)) return;
        Task memory t = _tasks.task(taskId);
        if (_passedOn[taskId] == t.attempt) return;
        vm.prank(_oracle);
        _oracles.rule(_finding(taskId, t, Ruling.None, 0), "");
        _passedOn[taskId] = t.attempt;
        _expectStanding(taskId, t, Ruling.Void, 0, _caseEnd(taskId));
    }

    /// @dev The auditor decides what was passed on, after everybody else who might has tried.
    function audit(uint256 which, uint8 said, uint256 amount) external inOrder {
        TaskId taskId = _find(which, TaskState.Ruled);
        if (taskId == NO_TASK || block.timestamp > _caseEnd(taskId)) return;
        Task memory t = _tasks.task(taskId);
        Ruling ruling = _ruling(said);
        Finding memory f = _finding(taskId, t, ruling, _amount(t, ruling, amount));
        if (_passedOn[taskId] != t.attempt) {
            _mustNotAudit(_auditor, f, "auditors decided what nobody passed on");
            return;
        }
        _mustNotAudit(t.creator, f, "the creator judged");
        address executor = _services.providerOf(t.serviceId);
        _mustNotAudit(executor, f, "the executor judged");
        _mustNotAudit(_owners[executor], f, "the executor's owner judged");
        f.ruling = Ruling.None;
        _mustNotAudit(_auditor, f, "an auditor did not decide");
        f.ruling = ruling;
        if (bytes(violation).length != 0) return;
        vm.prank(_auditor);
        _auditors.ruleFor(_oracles, f, "");
        _expectFinal(taskId, t, ruling, f.amount);
    }

    /// @dev Amounts that no ruling may carry.
    function payWrongly(uint256 which, uint256 amount) external inOrder {
        TaskId taskId = _findJudged(which, amount);
        if (taskId == NO_TASK || block.timestamp > _caseEnd(taskId)) return;
        Task memory t = _tasks.task(taskId);
        uint256 above = bound(amount, uint256(t.price) + 1, uint256(t.price) + 200 ether);
        Finding memory f = _finding(taskId, t, Ruling.Accepted, above);
        _mustNotStand(f, 0, "more than the price was paid");
        f.ruling = Ruling.Rejected;
        _mustNotStand(f, 0, "a rejection paid");
        f.ruling = Ruling.Impossible;
        _mustNotStand(f, 0, "an impossible task paid the price");
        f.ruling = Ruling.Void;
        _mustNotStand(f, 0, "a void paid");
        (f.ruling, f.amount) = (Ruling.None, 0);
        _mustNotStand(f, 0, "a ruling said nothing");
        f.ruling = Ruling.Accepted;
        if (t.price != 0) _mustNotStand(f, 0, "accepted for nothing");
    }

    /// @dev On nothing, on another proof, on another attempt, after the case.
    function ruleWrongly(uint256 which, bytes32 proofHash, uint8 attempt, bool accepted) external inOrder {
        TaskId taskId = taskNo(_any(which));
        if (taskId == NO_TASK) return;
        Task memory t = _tasks.task(taskId);
        bool judged = t.state == TaskState.Submitted || t.state == TaskState.Ruled;
        attempt %= 4;
        bool right = judged && t.attempt == attempt && t.proofHash == proofHash;
        if (right && block.timestamp <= _caseEnd(taskId)) return;
        Finding memory f =
            _finding(taskId, t, accepted ? Ruling.Accepted : Ruling.Rejected, accepted ? t.price : 0);
        (f.attempt, f.proofHash) = (attempt, proofHash);
        _mustNotStand(f, 0, "a wrong ruling was taken");
    }

    // -- anyone -------------------------------------------------------------------------------------------

    function expireTask(uint256 which) external inOrder {
        TaskId taskId = _find(which, TaskState.Assigned);
        if (taskId == NO_TASK) return;
        Task memory t = _tasks.task(taskId);
        if (block.timestamp <= (_hasAccepted(taskId, t) ? t.deadline : _graceEnd(t))) {
            try _tasks.expireTask(taskId) {
                violation = "expired before its time";
            } catch {}
            return;
        }
        _expire(taskId, t);
    }

    /// @dev A stranger, of any task, at any time.
    function conclude(uint256 which) external inOrder {
        TaskId taskId = taskNo(_any(which));
        if (taskId != NO_TASK) _conclude(taskId);
    }

    function _conclude(TaskId taskId) private {
        Task memory t = _tasks.task(taskId);
        Standing memory s = _standing[taskId];
        bool silent = t.state == TaskState.Submitted && block.timestamp > t.deadline;
        bool over = t.state == TaskState.Ruled && block.timestamp > s.until;
        uint256 end = silent ? _caseEnd(taskId) : 0;
        vm.prank(address(0xbad));
        try _tasks.conclude(taskId) {
            if (!silent && !over) violation = "a case was concluded before its time";
        } catch {
            if (silent || over) violation = "a case has no end";
            return;
        }
        if (over) _expectFinal(taskId, t, s.ruling, s.amount);
        else if (block.timestamp < end) _expectStanding(taskId, t, Ruling.Void, 0, end);
        else if (silent) _expectFinal(taskId, t, Ruling.Void, 0);
    }

    /// @dev A provider is switched off for a while: nothing that it was given gets a proof.
    function stayAway(uint256 who) external inOrder {
        _stayAway(_providers[bound(who, 0, _providers.length - 1)]);
    }

    /// @dev A provider that wakes up, as early as it can, and stays away again.
    function wakeAndStayAway(uint256 who) external inOrder {
        address provider = _providers[bound(who, 0, _providers.length - 1)];
        for (uint256 i = 0; i < 3; ++i) {
            uint256 until = asleepUntil[provider];
            if (block.timestamp < until) {
                vm.prank(provider);
                try _services.wakeUp() {
                    violation = "a provider woke up too early";
                } catch {}
                vm.warp(until);
            }
            if (until != 0 && bytes(violation).length == 0) {
                vm.prank(provider);
                _services.wakeUp();
                (missed[provider], asleepUntil[provider]) = (0, 0);
            }
            for (ServiceId serviceId = serviceNo(1); _exists(serviceId); serviceId = following(serviceId)) {
                Service memory s = _services.service(serviceId);
                if (s.provider != provider || s.state != ServiceState.Paused || _isShort(serviceId)) {
                    continue;
                }
                vm.prank(provider);
                _services.updateService(serviceId, 0, ServiceState.Active);
            }
            this.registerTask(0, 0, 3, 1);
            _stayAway(provider);
        }
    }

    function _stayAway(address provider) private {
        for (TaskId taskId = taskNo(1); _exists(taskId); taskId = following(taskId)) {
            Task memory t = _tasks.task(taskId);
            while (t.state == TaskState.Assigned && _services.providerOf(t.serviceId) == provider) {
                if (block.timestamp <= t.deadline) vm.warp(uint256(t.deadline) + 1);
                _expire(taskId, t);
                t = _tasks.task(taskId);
            }
        }
    }

    /// @dev The judge lets its window pass, and the administrator would rather have another one now.
    function staySilent(uint256 which, uint256 auditWindow) external inOrder {
        TaskId taskId = _find(which, TaskState.Submitted);
        if (taskId == NO_TASK) return;
        _setAudit(auditWindow);
        Task memory t = _tasks.task(taskId);
        if (block.timestamp <= t.deadline) vm.warp(uint256(t.deadline) + 1);
        _conclude(taskId);
    }

    function _expire(TaskId taskId, Task memory t) private {
        Service memory s = _services.service(t.serviceId);
        _tasks.expireTask(taskId);
        _expectMissed(s.provider);
        _expectAsleep(t, s);
        _expectFailure(taskId, t, _hasAccepted(taskId, t));
    }

    function _expectMissed(address provider) private {
        if (++missed[provider] < 3 || asleepUntil[provider] != 0) return;
        uint256 naps = _naps[provider]++;
        // The first time not at all, then ten minutes, then twice that each time, at most 21 hours.
        asleepUntil[provider] = block.timestamp + (naps == 0 ? 0 : 10 minutes * 2 ** _min(naps - 1, 7));
    }

    /// @dev After an attempt without a proof of the service that was `s` before.
    function _expectAsleep(Task memory t, Service memory s) private {
        bool off = asleepUntil[s.provider] != 0;
        ServiceState after_ = _services.service(t.serviceId).state;
        bool active = after_ == ServiceState.Active;
        if (s.state == ServiceState.Active && after_ != ServiceState.Suspended && off == active) {
            violation = "who is not there is asleep, and nobody else";
        }
    }

    /// @dev Work for others was accepted: its provider is there.
    function _expectForgiveness(Task memory t) private {
        address provider = _services.providerOf(t.serviceId);
        if (_isOwn(t.creator, provider)) return;
        (failures[provider], missed[provider], _naps[provider], asleepUntil[provider]) = (0, 0, 0, 0);
    }

    /// @dev Somebody sends the escrow tokens by mistake, and the administrator sends them on: to the last unit, and
    /// no more.
    function rescue(uint256 who, uint256 amount) external {
        address sender = _creators[bound(who, 0, _creators.length - 1)];
        amount = bound(amount, 0, _min(expected[sender], 5 ether));
        vm.prank(sender);
        _coin.transfer(address(_tasks), amount);
        vm.prank(_admin);
        _organization.rescueTokens(_coin, sender);
        if (_coin.balanceOf(sender) != expected[sender]) violation = "more or less was rescued";
    }

    function matchTask(uint256 which) external inOrder {
        TaskId taskId = _find(which, TaskState.Open);
        if (taskId != NO_TASK) _tasks.matchTask(taskId, NO_SERVICE);
    }

    function wait(uint256 time) external {
        vm.warp(block.timestamp + bound(time, 1 minutes, 45 minutes));
    }

    /// @dev What runs is done, and nobody works for a season; else running tasks would all expire.
    function rest(uint256 time) external {
        for (uint256 i = 0; i < 10; ++i) {
            this.submitProof(i, "");
            this.rule(i, ACCEPTED, NO_LIMIT);
        }
        for (TaskId taskId = taskNo(1); _exists(taskId); taskId = following(taskId)) {
            TaskState state = _tasks.task(taskId).state;
            if (state == TaskState.Assigned || state == TaskState.Submitted) return;
        }
        vm.warp(block.timestamp + bound(time, 30 days, 200 days));
    }

    /// @dev Whoever is no party tries everything; the rules give it nothing.
    function meddle(uint256 which, address who) external inOrder {
        TaskId taskId = taskNo(_any(which));
        if (taskId == NO_TASK || _isParty(who)) return;
        Task memory t = _tasks.task(taskId);
        vm.startPrank(who);
        try _tasks.cancelTask(taskId) {
            violation = "a stranger cancelled";
        } catch {}
        try _tasks.acceptTask(taskId, t.attempt) {
            violation = "a stranger accepted";
        } catch {}
        try _tasks.abandonTask(taskId, t.attempt) {
            violation = "a stranger abandoned";
        } catch {}
        try _tasks.submitProof(taskId, t.attempt, "meddled", "") {
            violation = "a stranger proved";
        } catch {}
        bytes memory cancel = abi.encodeCall(ITaskManager.cancelTask, (taskId));
        (bool believed,) = address(_tasks).call(bytes.concat(cancel, bytes20(t.creator)));
        if (believed) violation = "a stranger spoke for the creator";
        try _tasks.rule(taskId, t.attempt, t.proofHash, Ruling.Accepted, Fault.Nobody, t.price, 0, 0) {
            violation = "a stranger judged";
        } catch {}
        try _oracles.rule(_finding(taskId, t, Ruling.Accepted, t.price), "") {
            violation = "a stranger is an oracle";
        } catch {}
        try _oracles.ruleForNext(_finding(taskId, t, Ruling.Accepted, t.price), "") {
            violation = "a stranger is the next judge";
        } catch {}
        try _tasks.recordJudge(KindId.wrap(1), who, 1) {
            violation = "a stranger named a judge";
        } catch {}
        try _tasks.removeJudge(KindId.wrap(1)) {
            violation = "a stranger removed a judge";
        } catch {}
        try _tasks.onServiceFree(serviceNo(1)) {
            violation = "a stranger placed a service";
        } catch {}
        try _tasks.returnBond(who, 1) {
            violation = "a stranger took a bond";
        } catch {}
        try _tasks.withdrawPayments(t.creator) {
            violation = "a stranger collected";
        } catch {}
        try _services.release(serviceNo(1), Outcome.Completed, 1 ether, who, 0) {
            violation = "a stranger released a service";
        } catch {}
        try _services.conclude(serviceNo(1), taskId, Outcome.Completed, 1 ether, who, 1 ether) {
            violation = "a stranger concluded an attempt";
        } catch {}
        try _services.updateService(serviceNo(1), 0, ServiceState.Retired) {
            violation = "a stranger retired a service";
        } catch {}
        try _records.setPayout(_providers[0], who) {
            violation = "a stranger took a provider's payments";
        } catch {}
        try _records.recordOwner(who, address(0)) {
            violation = "a stranger recorded an owner";
        } catch {}
        try _services.suspend(serviceNo(1)) {
            violation = "a stranger suspended a service";
        } catch {}
        try _tasks.rescue(_coin, who) {
            violation = "a stranger rescued";
        } catch {}
        try _organization.withdraw(who, 1) {
            violation = "a stranger withdrew";
        } catch {}
        vm.stopPrank();
    }

    // -- the administrator --------------------------------------------------------------------------------

    function setTerms(uint96 bond, uint96 penalty, uint8 maxFailures) external {
        bond = uint96(bound(bond, 0, 60)) * 1 ether;
        penalty = uint96(bound(penalty, 0, bond));
        vm.prank(_admin);
        _organization.setTerms(Terms(bond, penalty, maxFailures % 4));
    }

    /// @dev One provider turns out to be another participant's device, or its owner to have been wrong. Signatures of
    /// another key, for another owner, and of an earlier time, are tried before.
    function registerDevice(uint256 who, uint256 whose) external {
        address provider = _providers[bound(who, 0, _providers.length - 1)];
        address owner = _creators[bound(whose, 0, _creators.length - 1)];
        uint256 nonce = _signatures[provider];
        if (_owners[provider] == owner) return;
        if (_register(provider, owner, _creators[0], owner, nonce)) {
            violation = "another's key was registered";
        }
        if (_register(provider, owner, provider, _admin, nonce)) violation = "a key agreed to another owner";
        if (nonce != 0 && _register(provider, owner, provider, owner, nonce - 1)) {
            violation = "a signature counted again";
        }
        if (!_register(provider, owner, provider, owner, nonce)) violation = "a device was not registered";
        _owners[provider] = owner;
        ++_signatures[provider];
    }

    /// @dev With a signature of `key` for `named`.
    function _register(address device, address owner, address key, address named, uint256 nonce)
        private
        returns (bool)
    {
        (bytes32 r, bytes32 vs) =
            Possession.sign(Possession.registryOf(_organization), block.chainid, key, named, nonce);
        vm.prank(_admin);
        try _organization.registerDevice(device, "wallet", owner, bytes32(uint256(uint160(device))), r, vs) {
            return true;
        } catch {
            return false;
        }
    }

    function setAudit(uint256 auditWindow) external {
        _setAudit(auditWindow);
    }

    function _setAudit(uint256 auditWindow) private {
        Kind memory k = _organization.kindOf(CLEANING);
        k.auditWindow = uint32(auditWindow % 3) * 1 hours;
        uint96 price = _organization.referencePriceOf(CLEANING);
        Windows memory w =
            Windows(k.minWindow, k.maxWindow, k.grace, k.minVerdictWindow, k.maxVerdictWindow, k.auditWindow);
        vm.prank(_admin);
        _organization.setWindows(CLEANING, w, price);
    }

    /// @dev Cleanings are the oracle's throughout; who judges charges changes.
    function allowKind(bool charging, uint256 who, uint256 which) external {
        IJudge[3] memory judges = [IJudge(_oracles), IJudge(_auditors), IJudge(address(0))];
        if (charging) _allowKind(CHARGING, judges[who % 3], _rulesAt(which));
        else _allowKind(CLEANING, _oracles, _rulesAt(which));
    }

    /// @dev An administrator who never retires anything.
    function allowAll(bool charging) external {
        bytes32 kind = charging ? CHARGING : CLEANING;
        for (uint256 i = 1; i < RULES; ++i) {
            _allowKind(kind, _judged[kind].judge, _rulesAt(i));
        }
    }

    function _allowKind(bytes32 kind, IJudge judge, bytes32 rules) private {
        Judged storage judged = _judged[kind];
        bool other = judge != judged.judge;
        bool full = judged.rules.length >= MAX_RULES && !_isCurrent(judged.rules, rules);
        bool right = address(judge) != address(0) && (rules == 0 || other || !full);
        vm.prank(_admin);
        try _organization.allowKind(kind, judge, rules) {
            if (!right) violation = "a kind was allowed without a judge, or with too many rules";
            if (other) delete judged.rules;
            judged.judge = judge;
            if (rules == 0) return;
            _forget(judged, rules);
            judged.rules.push(rules);
        } catch {
            if (right) violation = "a kind could not be allowed";
        }
    }

    function retireRules(bool charging, uint256 which) external {
        bytes32 kind = charging ? CHARGING : CLEANING;
        Judged storage judged = _judged[kind];
        uint256 count = judged.rules.length;
        // Every other one is current.
        bytes32 rules = which % 2 == 0 || count == 0 ? _rulesAt(which) : judged.rules[which % count];
        bool right = _isCurrent(judged.rules, rules) && count > 1;
        vm.prank(_admin);
        try _organization.retireRules(kind, rules) {
            if (!right) violation = "rules were retired that are not current, or the last";
            _forget(judged, rules);
        } catch {
            if (right) violation = "rules could not be retired";
        }
    }

    function disallowKind() external {
        vm.prank(_admin);
        _organization.disallowKind(CHARGING);
        delete _judged[CHARGING].rules;
    }

    /// @dev One in twelve is none.
    function _rulesAt(uint256 which) private pure returns (bytes32) {
        return which % RULES == 0 ? bytes32(0) : keccak256(abi.encode(which % RULES));
    }

    function _isCurrent(bytes32[] memory current, bytes32 rules) private pure returns (bool) {
        for (uint256 i = 0; i < current.length; ++i) {
            if (current[i] == rules) return true;
        }
        return false;
    }

    function _forget(Judged storage judged, bytes32 rules) private {
        bytes32[] memory before = judged.rules;
        delete judged.rules;
        for (uint256 i = 0; i < before.length; ++i) {
            if (before[i] != rules) judged.rules.push(before[i]);
        }
    }

    function setPolicy(uint256 which) external {
        vm.prank(_admin);
        _organization.setPolicy(_policies[bound(which, 0, _policies.length - 1)]);
    }

    function suspend(uint256 which) external {
        ServiceId serviceId = serviceNo(_anyService(which));
        // One in four, else hardly any would work.
        if (serviceId == NO_SERVICE || which % 4 != 0) return;
        Service memory s = _services.service(serviceId);
        if (s.state == ServiceState.Retired || s.state == ServiceState.Suspended) return;
        vm.prank(_admin);
        _organization.suspendService(serviceId);
        ghost[serviceId].suspended = true;
    }

    function suspendProvider(uint256 who) external {
        // One in eight, else hardly any would work.
        if (who % 8 != 0) return;
        address provider = _providers[bound(who / 8, 0, _providers.length - 1)];
        if (_suspended[provider]) return;
        vm.prank(_admin);
        _organization.suspendProvider(provider);
        _suspended[provider] = true;
        _expectAllSuspended(provider);
    }

    function reinstateProvider(uint256 who) external {
        address provider = _providers[bound(who, 0, _providers.length - 1)];
        if (!_suspended[provider]) return;
        vm.prank(_admin);
        _organization.reinstateProvider(provider);
        _suspended[provider] = false;
    }

    function reinstate(uint256 which) external {
        ServiceId serviceId = serviceNo(_anyService(which));
        if (serviceId == NO_SERVICE || _services.service(serviceId).state != ServiceState.Suspended) return;
        Ghost storage g = ghost[serviceId];
        if (g.bond < g.penalty || _suspended[_services.providerOf(serviceId)]) return;
        vm.prank(_admin);
        _organization.reinstateService(serviceId);
        g.suspended = false;
        failures[_services.providerOf(serviceId)] = 0;
    }

    // -- the rules ----------------------------------------------------------------------------------------

    function _finding(TaskId taskId, Task memory t, Ruling ruling, uint256 amount)
        private
        pure
        returns (Finding memory)
    {
        return Finding(taskId, t.attempt, t.proofHash, 0, 0, ruling, Fault.Nobody, uint96(amount), "");
    }

    /// @dev In the name of the contract that judges.
    function _stand(Finding memory f, uint256 until) private {
        vm.prank(address(_oracles));
        _tasks.rule(f.taskId, f.attempt, f.proofHash, f.ruling, f.fault, f.amount, uint40(until), 0);
    }

    function _mustNotStand(Finding memory f, uint256 until, string memory what) private {
        vm.prank(address(_oracles));
        try _tasks.rule(f.taskId, f.attempt, f.proofHash, f.ruling, f.fault, f.amount, uint40(until), 0) {
            violation = what;
        } catch {}
    }

    function _mustNot(address who, Finding memory f, string memory what) private {
        vm.prank(who);
        try _oracles.rule(f, "") {
            violation = what;
        } catch {}
    }

    function _mustNotAudit(address who, Finding memory f, string memory what) private {
        vm.prank(who);
        try _auditors.ruleFor(_oracles, f, "") {
            violation = what;
        } catch {}
    }

    /// @dev One of the five.
    function _ruling(uint8 said) private pure returns (Ruling) {
        return Ruling(said == 0 ? 1 : (said - 1) % 5 + 1);
    }

    /// @dev What a ruling may pay.
    function _amount(Task memory t, Ruling ruling, uint256 amount) private pure returns (uint256) {
        return ruling == Ruling.Accepted && t.price != 0 ? bound(amount, 1, t.price) : 0;
    }

    /// @dev A ruling stands. With the first one its service is free, and the penalty alone is set aside.
    function _expectStanding(TaskId taskId, Task memory t, Ruling ruling, uint256 amount, uint256 until)
        private
    {
        uint96 aside = _standing[taskId].penalty;
        if (t.state == TaskState.Submitted) {
            Ghost storage g = ghost[t.serviceId];
            aside = uint96(_min(g.penalty, g.bond));
            g.bond -= aside;
            _expectRelease(t.serviceId);
        }
        _standing[taskId] = Standing(t.proofHash, ruling, uint96(amount), uint40(until), aside, false);
        if (_tasks.task(taskId).state != TaskState.Ruled) violation = "a ruling does not stand";
    }

    /// @dev What a ruling comes to, whether one stood before or not.
    function _expectFinal(TaskId taskId, Task memory t, Ruling ruling, uint256 amount) private {
        bool stood = t.state == TaskState.Ruled;
        uint256 aside = _standing[taskId].penalty;
        delete _standing[taskId];
        if (ruling == Ruling.Accepted || ruling == Ruling.Impossible) {
            _expectPayment(t, ruling == Ruling.Accepted ? amount : t.price / 10);
        } else {
            bool ends = ruling == Ruling.Void || (ruling == Ruling.GivenUp && t.hired != Hire.None);
            if (ruling == Ruling.GivenUp && t.hired == Hire.None) {
                ends = _gaveUp[taskId];
                _gaveUp[taskId] = true;
                _passed[taskId].push(_services.providerOf(t.serviceId));
            }
            if (ends || _isLast(taskId, t)) expected[t.creator] += t.reward;
        }
        if (ruling == Ruling.Accepted) {
            _expectForgiveness(t);
            _expectReputation(t, amount, 0);
        }
        Ghost storage g = ghost[t.serviceId];
        if (stood && ruling != Ruling.Rejected) {
            bool retired = _services.service(t.serviceId).state == ServiceState.Retired;
            if (retired) expected[_payoutOf(_services.providerOf(t.serviceId))] += aside;
            else g.bond += aside;
            _expectExhaustion(t.serviceId, retired);
        }
        if (ruling == Ruling.Rejected) {
            g.bond += aside;
            _expectBlame(t, stood ? aside : _min(g.penalty, g.bond));
        }
        if (!stood) _expectRelease(t.serviceId);
    }

    function _expectPayment(Task memory t, uint256 amount) private {
        expected[_payoutOf(_services.providerOf(t.serviceId))] += amount;
        expected[t.creator] += t.reward - amount;
    }

    function _expectFailure(TaskId taskId, Task memory t, bool blamed) private {
        if (!blamed && t.hired == Hire.None) _passed[taskId].push(_services.providerOf(t.serviceId));
        // Where nobody else was asked for, what does not count ends the task.
        bool ends = !blamed && t.hired != Hire.None;
        if (ends || _isLast(taskId, t)) expected[t.creator] += t.reward;
        Ghost storage g = ghost[t.serviceId];
        if (blamed) _expectBlame(t, _min(g.penalty, g.bond));
        _expectRelease(t.serviceId);
    }

    /// @dev The attempt counts against its provider, and costs so much of the bond.
    function _expectBlame(Task memory t, uint256 penalty) private {
        Ghost storage g = ghost[t.serviceId];
        address provider = _services.providerOf(t.serviceId);
        ++failures[provider];
        _expectReputation(t, 0, t.price);
        g.bond -= penalty;
        expected[address(_organization)] += penalty;
        bool repeated = g.maxFailures != 0 && failures[provider] >= g.maxFailures;
        bool retired = _services.service(t.serviceId).state == ServiceState.Retired;
        if (repeated && !retired) g.suspended = true;
        if (repeated) _expectAllSuspended(provider);
        _expectExhaustion(t.serviceId, retired);
    }

    /// @dev The bond no longer covers a penalty, and none that is set aside may come back.
    function _expectExhaustion(ServiceId serviceId, bool retired) private {
        Ghost storage g = ghost[serviceId];
        if (retired || g.bond >= g.penalty) return;
        for (TaskId taskId = taskNo(1); _exists(taskId); taskId = following(taskId)) {
            if (_standing[taskId].penalty != 0 && _tasks.task(taskId).serviceId == serviceId) return;
        }
        g.suspended = true;
    }

    function _expectAllSuspended(address provider) private {
        for (ServiceId serviceId = serviceNo(1); _exists(serviceId); serviceId = following(serviceId)) {
            Service memory s = _services.service(serviceId);
            if (s.provider == provider && s.state != ServiceState.Retired) ghost[serviceId].suspended = true;
        }
    }

    function _expectRelease(ServiceId serviceId) private {
        Service memory s = _services.service(serviceId);
        if (s.state == ServiceState.Retired) _expectBondBack(serviceId, s.provider);
    }

    function _expectBondBack(ServiceId serviceId, address provider) private {
        expected[_payoutOf(provider)] += ghost[serviceId].bond;
        ghost[serviceId].bond = 0;
    }

    function _isParty(address who) private view returns (bool) {
        for (uint256 i = 0; i < _creators.length; ++i) {
            if (who == _creators[i]) return true;
        }
        for (uint256 i = 0; i < _providers.length; ++i) {
            if (who == _providers[i]) return true;
        }
        return who == _oracle || who == _auditor || who == _admin || who == address(_tasks)
            || who == address(_services) || who == address(_organization) || who == _tasks.signedRequests();
    }

    function _price(uint256 price) private pure returns (uint256) {
        return bound(price, 0, 15) * 10 ether;
    }

    function _any(uint256 which) private view returns (uint256) {
        uint256 tasks = _tasks.taskCount();
        return tasks == 0 ? 0 : which % tasks + 1;
    }

    function _anyService(uint256 which) private view returns (uint256) {
        uint256 services = _services.serviceCount();
        return services == 0 ? 0 : which % services + 1;
    }

    /// @dev Until then a ruling can be replaced.
    function _caseEnd(TaskId taskId) private view returns (uint256) {
        return _tasks.task(taskId).deadline + _auditWindow[taskId];
    }

    /// @dev A task whose proof waits for a ruling, or, every fourth time, has one that stands.
    function _findJudged(uint256 which, uint256 seed) private view returns (TaskId taskId) {
        taskId = seed % 4 == 1 ? _find(which, TaskState.Ruled) : NO_TASK;
        if (taskId == NO_TASK) taskId = _find(which, TaskState.Submitted);
    }

    /// @dev Some task in `state`, searched from a random place; 0 if there is none.
    function _find(uint256 which, TaskState state) private view returns (TaskId) {
        uint256 tasks = _tasks.taskCount();
        for (uint256 i = 0; i < tasks; ++i) {
            TaskId taskId = taskNo((which % tasks + i) % tasks + 1);
            if (_tasks.task(taskId).state == state) return taskId;
        }
        return NO_TASK;
    }

    function _min(uint256 a, uint256 b) private pure returns (uint256) {
        return a < b ? a : b;
    }

    function _exists(TaskId taskId) private view returns (bool) {
        return TaskId.unwrap(taskId) <= _tasks.taskCount();
    }

    function _exists(ServiceId serviceId) private view returns (bool) {
        return ServiceId.unwrap(serviceId) <= _services.serviceCount();
    }
}
