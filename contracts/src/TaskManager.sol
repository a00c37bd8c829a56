// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {IERC20} from "@openzeppelin/contracts/token/ERC20/IERC20.sol";
import {SafeERC20} from "@openzeppelin/contracts/token/ERC20/utils/SafeERC20.sol";
import {ReentrancyGuardTransient} from "@openzeppelin/contracts/utils/ReentrancyGuardTransient.sol";
import {Math} from "@openzeppelin/contracts/utils/math/Math.sol";
import {SafeCast} from "@openzeppelin/contracts/utils/math/SafeCast.sol";
import {SignedRequests} from "./SignedRequests.sol";
import {ITaskQueues} from "./interfaces/ITaskQueues.sol";
import {TaskQueues} from "./TaskQueues.sol";
import {IOrganization} from "./interfaces/IOrganization.sol";
import {IProviders, Outcome} from "./interfaces/IProviders.sol";
import {IServiceListener} from "./interfaces/IServiceListener.sol";
import {Hire, IServiceManager, Release} from "./interfaces/IServiceManager.sol";
import {
    Cause,
    Fault,
    IMPOSSIBLE_SHARE,
    ITaskManager,
    Judged,
    Ruling,
    Standing,
    Task,
    TaskRequest,
    TaskState
} from "./interfaces/ITaskManager.sol";
import {Payments} from "./libraries/Payments.sol";
import {Relayed} from "./libraries/Relayed.sol";
import {Record, TaskRecords} from "./libraries/TaskRecords.sol";
import {Texts} from "./libraries/Texts.sol";
import {Units} from "./libraries/Units.sol";
import {KindId} from "./types/KindId.sol";
import {NOBODY, Passed} from "./types/Passed.sol";
import {NO_SERVICE, ServiceId} from "./types/ServiceId.sol";
import {NO_TASK, TaskId} from "./types/TaskId.sol";

contract TaskManager is ITaskManager, ReentrancyGuardTransient {
    using SafeCast for uint256;
    using SafeERC20 for IERC20;
    using TaskRecords for TaskRecords.Store;

    /// @dev In one word, because a registration writes two of them, and a verdict the others.
    struct Totals {
        uint40 tasks;
        /// @dev Open tasks of all queues, so that nobody looks into a queue while there are none.
        uint40 waiting;
        /// @dev How often a service began to wait. Each gets the next number, so that the lower was there earlier.
        uint40 places;
        /// @dev What IOrganization.admission says. Known here, because each task and each verdict would pay 2,100 gas to look it up.
        bool asks;
        bool restricted;
        uint120 held;
    }

    /// @dev The provider of a service, and the proof of the task that it does now. A service does one task at a
    /// time, and its word is written over with the next: a quarter of the gas of a word per task.
    struct Worker {
        address executor;
        bytes32 proof;
    }

    /// @dev The judge of a kind's number, in one word, which each ruling reads.
    /// @param referencePrice the most that an attempt counts in a record. No price of a service has more bits (Units.max)
    struct Bench {
        address judge;
        bool removed;
        uint88 referencePrice;
    }

    /// @dev Of attempts that count. With those that do not they fit in four bits.
    uint8 private constant MAX_ATTEMPTS = 7;

    /// @dev How long a task that only proven providers are offered waits for one, s. Then anybody may give it to a service
    /// of another (see matchTask): an active one of a proven provider may be too dear, or busy for long, or be there for show.
    uint256 private constant PATIENCE = 1 hours;

    /// @dev Makes the word of a service's proofs when the service is made, so that no task pays for it.
    bytes32 private constant NO_PROOF = bytes32(uint256(1));

    IERC20 public immutable token;
    IOrganization public immutable organization;
    IServiceManager public immutable services;
    IProviders private immutable _providers;
    uint256 private immutable _unit;
    /// @inheritdoc ITaskManager
    address public immutable signedRequests;
    /// @inheritdoc ITaskManager
    ITaskQueues public immutable queues;

    Totals private _totals;
    TaskRecords.Store private _tasks;
    mapping(ServiceId serviceId => Worker) private _workers;
    mapping(KindId kindId => Bench) private _benches;
    /// @dev Only of tasks that are Ruled.
    mapping(TaskId taskId => Standing) private _standing;
    /// @inheritdoc ITaskManager
    mapping(address account => uint256) public pendingPayments;

    modifier onlyServiceManager() {
        _requireServiceManager();
        _;
    }

    modifier onlyOrganization() {
        _requireOrganization();
        _;
    }

    constructor(IOrganization organization_, IServiceManager services_) {
        if (
            address(organization_.tasks()) != address(this)
                || address(organization_.services()) != address(services_)
        ) {
            revert NotWired(address(organization_), address(services_));
        }
        organization = organization_;
        (services, _providers) = (services_, services_.providers());
        token = organization_.token();
        // slither-disable-next-line unused-return
        (_unit,) = Units.unitOf(token);
        signedRequests = address(new SignedRequests());
        queues = new TaskQueues(organization_, services_);
        updateAdmission();
    }

    /// @inheritdoc ITaskManager
    function registerTask(TaskRequest calldata request) external nonReentrant returns (TaskId) {
        return _register(_sender(), request);
    }

    /// @inheritdoc ITaskManager
    function cancelTask(TaskId taskId) external nonReentrant {
        Record memory t = _get(taskId);
        address caller = _sender();
        if (caller != t.creator) revert NotCreator(taskId, caller, t.creator);
        _requireState(taskId, t, TaskState.Open);
        _leaveQueue(taskId, t);
        t.state = TaskState.Cancelled;
        _tasks.save(taskId, t, _unit);
        emit TaskCancelled(taskId, t.reward);
        _pay(t.creator, t.reward);
    }

    /// @inheritdoc ITaskManager
    function acceptTask(TaskId taskId, uint8 attempt) external {
        Record memory t = _progress(taskId);
        address executor = _requireExecutor(taskId, t, attempt);
        if (t.accepted) revert AlreadyAccepted(taskId, attempt);
        t.accepted = true;
        _tasks.save(taskId, t, _unit);
        emit TaskAccepted(taskId, attempt, executor);
    }

    /// @inheritdoc ITaskManager
    function abandonTask(TaskId taskId, uint8 attempt) external nonReentrant {
        Record memory t = _get(taskId);
        _requireExecutor(taskId, t, attempt);
        bool late = t.accepted && block.timestamp > _graceEnd(t);
        _failAttempt(taskId, t, late ? Cause.AbandonedLate : Cause.Abandoned);
    }

    /// @inheritdoc ITaskManager
    function submitProof(TaskId taskId, uint8 attempt, bytes32 proofHash, string calldata uri)
        external
        nonReentrant
    {
        Record memory t = _progress(taskId);
        address executor = _requireExecutor(taskId, t, attempt);
        if (proofHash == 0) revert EmptyProof(taskId);
        Texts.requireText(uri);
        (t.state, t.time) = (TaskState.Submitted, block.timestamp);
        _tasks.save(taskId, t, _unit);
        _workers[t.serviceId].proof = proofHash;
        emit ProofSubmitted(taskId, attempt, executor, proofHash, uri);
    }

    /// @inheritdoc ITaskManager
    function rule(
        TaskId taskId,
        uint8 attempt,
        bytes32 proofHash,
        Ruling ruling,
        Fault fault,
        uint96 amount,
        uint40 until,
        bytes32 report
    ) external nonReentrant returns (Judged memory judged) {
        Record memory t = _get(taskId);
        bool afterRemoval = _requireJudge(t.kindId);
        _requireRuling(taskId, t, ruling, amount, until);
        _requireAttempt(taskId, t, attempt);
        bytes32 proof = _proof(taskId, t);
        if (proofHash != proof) revert ProofMismatch(taskId, proof, proofHash);
        (judged.creator, judged.kindId) = (t.creator, t.kindId);
        (judged.submitted, judged.ruled) = (uint40(t.time), t.state == TaskState.Ruled);
        judged.provider =
            _say(taskId, t, Standing(proofHash, ruling, amount, until, 0, afterRemoval), fault, report);
    }

    /// @inheritdoc ITaskManager
    function conclude(TaskId taskId) external nonReentrant {
        Record memory t = _get(taskId);
        if (t.state == TaskState.Submitted) {
            _requireOver(taskId, t.time + t.verdictWindow);
            _void(taskId, t, _benches[t.kindId].removed);
            return;
        }
        _requireState(taskId, t, TaskState.Ruled);
        Standing storage s = _standing[taskId];
        if (_benches[t.kindId].removed && !s.afterRemoval) {
            _void(taskId, t, true);
            return;
        }
        if (block.timestamp <= s.until) revert RulingStands(taskId, s.until, block.timestamp);
        _finish(taskId, t, s.ruling, s.amount);
    }

    /// @inheritdoc ITaskManager
    function expireTask(TaskId taskId) external nonReentrant {
        Record memory t = _get(taskId);
        _requireState(taskId, t, TaskState.Assigned);
        _requireOver(taskId, t.accepted ? t.time : _graceEnd(t));
        _failAttempt(taskId, t, t.accepted ? Cause.ExecutionExpired : Cause.NotAccepted);
    }

    /// @inheritdoc ITaskManager
    function matchTask(TaskId taskId, ServiceId serviceId) external nonReentrant {
        Record memory t = _get(taskId);
        _requireState(taskId, t, TaskState.Open);
        Passed passed = _leaveQueue(taskId, t);
        if (passed.isForProven() && serviceId != NO_SERVICE && block.timestamp > t.time + PATIENCE) {
            // slither-disable-next-line unused-return
            (uint32 number,,) = services.profile(serviceId);
            if (!passed.has(number)) passed = NOBODY;
        }
        if (serviceId == NO_SERVICE) {
            _match(taskId, t, passed);
        } else if (t.hired != Hire.None || !_assign(taskId, t, serviceId, passed)) {
            revert ServiceDoesNotFit(taskId, serviceId);
        }
    }

    /// @inheritdoc ITaskManager
    function withdrawPayments(address account) external nonReentrant {
        uint256 amount = pendingPayments[account];
        if (amount == 0) revert NothingOwed(account);
        pendingPayments[account] = 0;
        _totals.held -= uint120(amount);
        emit PaymentCollected(account, amount);
        token.safeTransfer(_providers.payoutOf(account), amount);
    }

    /// @inheritdoc IServiceListener
    function onServiceFree(ServiceId serviceId) external nonReentrant onlyServiceManager {
        _place(serviceId);
    }

    /// @inheritdoc IServiceListener
    function enter(ServiceId serviceId, address provider, uint256 bond)
        external
        nonReentrant
        onlyServiceManager
    {
        _workers[serviceId] = Worker(provider, NO_PROOF);
        _totals.held += uint120(bond);
        _take(provider, bond);
    }

    /// @inheritdoc IServiceListener
    function returnBond(address payout, uint256 amount) external nonReentrant onlyServiceManager {
        _pay(payout, amount);
    }

    /// @inheritdoc ITaskManager
    function recordJudge(KindId kindId, address judge, uint96 referencePrice) external onlyOrganization {
        if (referencePrice == 0 || !Units.isPrice(referencePrice, _unit)) {
            revert IServiceManager.InvalidPrice(referencePrice, _unit, Units.max(_unit));
        }
        (_benches[kindId].judge, _benches[kindId].referencePrice) = (judge, uint88(referencePrice));
    }

    /// @inheritdoc ITaskManager
    function updateAdmission() public {
        (_totals.asks, _totals.restricted) = organization.admission();
    }

    /// @inheritdoc ITaskManager
    function removeJudge(KindId kindId) external onlyOrganization {
        _benches[kindId].removed = true;
    }

    /// @inheritdoc ITaskManager
    function rescue(IERC20 token_, address to)
        external
        nonReentrant
        onlyOrganization
        returns (uint256 amount)
    {
        amount = token_.balanceOf(address(this));
        if (token_ == token) amount -= _totals.held;
        if (amount != 0) token_.safeTransfer(to, amount);
    }

    /// @inheritdoc ITaskManager
    function task(TaskId taskId) external view returns (Task memory) {
        Record memory t = _get(taskId);
        bool waits = t.state == TaskState.Open || t.state == TaskState.Cancelled;
        bool ofProvider = t.hired == Hire.Provider;
        bool judged = t.state == TaskState.Submitted || t.state == TaskState.Ruled;
        uint256 deadline = judged ? t.time + t.verdictWindow : waits ? 0 : t.time;
        return Task({
            creator: t.creator,
            reward: uint96(t.reward),
            kindId: t.kindId,
            price: uint96(t.price),
            serviceId: ofProvider && waits ? NO_SERVICE : t.serviceId,
            provider: ofProvider ? _workers[t.serviceId].executor : address(0),
            executionWindow: t.executionWindow,
            verdictWindow: t.verdictWindow,
            deadline: uint40(deadline),
            caseEnd: judged ? uint40(_caseEnd(t)) : 0,
            attempt: t.attempt,
            maxAttempts: t.maxAttempts,
            state: t.state,
            accepted: t.accepted,
            hired: t.hired,
            proofHash: _proof(taskId, t)
        });
    }

    /// @inheritdoc ITaskManager
    function standing(TaskId taskId) external view returns (Standing memory) {
        return _standing[taskId];
    }

    /// @inheritdoc ITaskManager
    function isRemoved(KindId kindId) external view returns (bool) {
        return _benches[kindId].removed;
    }

    /// @inheritdoc IServiceListener
    function taskCount() external view returns (uint256) {
        return _totals.tasks;
    }

    /// @inheritdoc ITaskManager
    function held() external view returns (uint256) {
        return _totals.held;
    }

    function _register(address creator, TaskRequest calldata request) private returns (TaskId taskId) {
        // slither-disable-next-line uninitialized-local
        Record memory t;
        bytes32 rules;
        (rules, t.kindId, t.auditWindow, t.grace) = organization.admitTask(
            request.kind,
            creator,
            request.executionWindow,
            request.verdictWindow,
            request.rules,
            _totals.restricted
        );
        if (request.maxAttempts == 0 || request.maxAttempts > MAX_ATTEMPTS) {
            revert InvalidAttempts(request.maxAttempts, MAX_ATTEMPTS);
        }
        Texts.requireParams(request.params);
        uint40 number = _totals.tasks + 1;
        _totals.tasks = number;
        taskId = TaskId.wrap(number);
        (t.creator, t.reward) = (creator, request.reward.toUint88());
        _totals.held += uint120(t.reward);
        (t.executionWindow, t.verdictWindow) = (request.executionWindow, request.verdictWindow);
        (t.maxAttempts, t.state) = (request.maxAttempts, TaskState.Open);
        emit TaskRegistered(
            taskId,
            creator,
            request.kind,
            request.reward,
            request.executionWindow,
            request.verdictWindow,
            request.maxAttempts,
            rules,
            request.params
        );
        if (request.serviceId != 0 || request.provider != address(0)) {
            t.hired = request.serviceId != 0 ? Hire.Service : Hire.Provider;
            t.serviceId =
                queues.hire(creator, request.serviceId, request.provider, request.kind, request.reward);
            if (t.hired == Hire.Service) emit ServiceRequested(taskId, t.serviceId);
            else emit ProviderRequested(taskId, request.provider);
        }
        _tasks.keepConditions(taskId, t);
        _match(taskId, t, NOBODY);
        _take(creator, request.reward);
    }

    /// @dev Give an open task that is in no queue to a service, or let it wait in its place.
    function _match(TaskId taskId, Record memory t, Passed passed) private {
        bool asks = t.hired == Hire.None && _totals.asks;
        ServiceId serviceId = t.serviceId;
        if (asks) serviceId = queues.serviceFor(t.kindId, t.reward, passed);
        if (!asks || serviceId != NO_SERVICE) {
            if (_assign(taskId, t, serviceId, passed)) return;
            if (asks) emit PolicyFailed(taskId);
        }
        _tasks.save(taskId, t, _unit);
        queues.put(taskId, t.kindId, _named(t), t.reward, passed);
        ++_totals.waiting;
    }

    /// @dev Give an available service that is in no line its next task, or let it wait.
    function _place(ServiceId serviceId) private {
        TaskId taskId = NO_TASK;
        Passed passed = NOBODY;
        bool failed = false;
        if (_totals.waiting != 0) (taskId, passed, failed) = queues.take(serviceId, _totals.asks);
        if (taskId == NO_TASK) {
            services.enqueue(serviceId, ++_totals.places);
            return;
        }
        --_totals.waiting;
        if (failed) emit PolicyFailed(taskId);
        bool assigned = _assign(taskId, _get(taskId), serviceId, passed);
        assert(assigned);
    }

    /// @return passed the providers that the task has passed
    function _leaveQueue(TaskId taskId, Record memory t) private returns (Passed passed) {
        --_totals.waiting;
        return queues.remove(taskId, t.kindId, _named(t), t.attempt != 0);
    }

    /// @dev The service's attempt is over, and it has its next task or waits for one.
    function _free(Record memory t, ServiceId serviceId, Outcome outcome, uint256 value)
        private
        returns (Release memory r)
    {
        r = _release(t, serviceId, outcome, value);
        if (r.available) _place(serviceId);
    }

    /// @dev The service's attempt is over. While no task waits, it is in line again after this call.
    function _release(Record memory t, ServiceId serviceId, Outcome outcome, uint256 value)
        private
        returns (Release memory r)
    {
        uint40 place = _totals.waiting == 0 ? _totals.places + 1 : 0;
        r = services.release(serviceId, outcome, _counted(t.kindId, outcome, value), t.creator, place);
        if (place == 0 || !r.available) return r;
        (_totals.places, r.available) = (place, false);
    }

    /// @dev The case of an attempt is over whose service was free before: its penalty is lost, or part of its bond again.
    function _conclude(TaskId taskId, Record memory t, Outcome outcome, uint256 value)
        private
        returns (Release memory)
    {
        uint96 penalty = _standing[taskId].penalty;
        delete _standing[taskId];
        value = _counted(t.kindId, outcome, value);
        return services.conclude(t.serviceId, taskId, outcome, value, t.creator, penalty);
    }

    /// @dev What an attempt counts in its provider's record. The kind's word was read for the ruling.
    function _counted(KindId kindId, Outcome outcome, uint256 value) private view returns (uint256) {
        // Other outcomes, of which some never came to a judge, go into no record.
        if (outcome > Outcome.AbandonedLate) return 0;
        return Math.min(value, _benches[kindId].referencePrice);
    }

    /// @dev Whether the service takes the task, at its own price; nothing happened if not.
    function _assign(TaskId taskId, Record memory t, ServiceId serviceId, Passed passed)
        private
        returns (bool)
    {
        address executor;
        uint256 price;
        bool accepted;
        (serviceId, executor, price, accepted) =
            services.reserve(serviceId, t.kindId, t.reward, passed, taskId, t.hired);
        if (executor == address(0)) return false;
        uint256 deadline = block.timestamp + t.executionWindow;
        uint8 attempt = t.attempt + 1;
        (t.serviceId, t.price, t.time) = (serviceId, price, deadline.toUint32());
        (t.attempt, t.state, t.accepted) = (attempt, TaskState.Assigned, accepted);
        _tasks.save(taskId, t, _unit);
        // Time and sender, too: there are chains whose `prevrandao` is constant and whose block hashes say little.
        bytes32 nonce = keccak256(
            abi.encode(
                block.chainid,
                address(this),
                taskId,
                attempt,
                block.prevrandao,
                blockhash(block.number - 1),
                block.timestamp,
                msg.sender
            )
        );
        emit TaskAssigned(taskId, attempt, executor, serviceId, price, nonce, deadline);
        return true;
    }

    /// @dev A ruling stands now, or is done at once.
    /// @return provider whose attempt it is about
    function _say(TaskId taskId, Record memory t, Standing memory s, Fault fault, bytes32 report)
        private
        returns (address provider)
    {
        if (s.ruling != Ruling.Void) fault = Fault.Nobody;
        emit Ruled(taskId, t.attempt, s.proofHash, s.ruling, fault, s.amount, s.until, report);
        return s.until != 0 ? _stand(taskId, t, s) : _finish(taskId, t, s.ruling, s.amount);
    }

    /// @dev A ruling stands now. With the first one the service is free, but for its penalty.
    function _stand(TaskId taskId, Record memory t, Standing memory s) private returns (address provider) {
        if (t.state == TaskState.Ruled) {
            s.penalty = _standing[taskId].penalty;
            _standing[taskId] = s;
            return _workers[t.serviceId].executor;
        }
        t.state = TaskState.Ruled;
        _tasks.save(taskId, t, _unit);
        Release memory r = _free(t, t.serviceId, Outcome.Pending, 0);
        s.penalty = uint96(r.penalty);
        _standing[taskId] = s;
        _pay(r.payout, r.bond);
        return r.provider;
    }

    /// @dev Nobody has ruled, or who did may no more: void until the case ends, and at once if it has ended.
    function _void(TaskId taskId, Record memory t, bool afterRemoval) private {
        uint256 caseEnd = _caseEnd(t);
        uint40 until = block.timestamp < caseEnd ? uint40(caseEnd) : 0;
        Standing memory s = Standing(_proof(taskId, t), Ruling.Void, 0, until, 0, afterRemoval);
        _say(taskId, t, s, Fault.Oracle, 0);
    }

    /// @dev A ruling is done, whether it stood before or not.
    function _finish(TaskId taskId, Record memory t, Ruling ruling, uint256 amount)
        private
        returns (address provider)
    {
        if (ruling == Ruling.Accepted) return _settle(taskId, t, amount, Outcome.Completed);
        if (ruling == Ruling.Impossible) {
            return _settle(taskId, t, t.price / IMPOSSIBLE_SHARE, Outcome.Unjudged);
        }
        if (ruling == Ruling.Rejected) return _failAttempt(taskId, t, Cause.Rejected);
        return _failAttempt(taskId, t, ruling == Ruling.GivenUp ? Cause.GivenUp : Cause.Void);
    }

    function _settle(TaskId taskId, Record memory t, uint256 amount, Outcome outcome)
        private
        returns (address provider)
    {
        bool stood = t.state == TaskState.Ruled;
        _end(taskId, t, TaskState.Settled);
        uint256 refund = t.reward - amount;
        Release memory r =
            stood ? _conclude(taskId, t, outcome, amount) : _release(t, t.serviceId, outcome, amount);
        emit TaskSettled(taskId, r.payout, amount, refund);
        if (r.available) _place(t.serviceId);
        uint120 sent = _send(0, r.payout, amount + r.bond);
        sent = _send(sent, t.creator, refund);
        _totals.held -= sent;
        return r.provider;
    }

    function _end(TaskId taskId, Record memory t, TaskState state) private {
        (t.state, t.time) = (state, 0);
        _tasks.save(taskId, t, _unit);
    }

    /// @dev The next attempt goes to another service that waits, before the one that failed gets its next task.
    function _failAttempt(TaskId taskId, Record memory t, Cause cause) private returns (address provider) {
        (ServiceId serviceId, uint256 price) = (t.serviceId, t.price);
        bool stood = t.state == TaskState.Ruled;
        // slither-disable-next-line uninitialized-local
        Release memory r;
        if (stood) {
            r = _conclude(taskId, t, _outcome(cause), price);
            // Before the task looks for a service: it may name this one, which would have two places.
            if (r.available) _place(serviceId);
        }
        bool last = _endAttempt(taskId, t, cause);
        if (!stood) r = _free(t, serviceId, _outcome(cause), price);
        uint120 sent = _send(0, r.payout, r.bond);
        sent = _send(sent, address(organization), r.penalty);
        if (last) sent = _send(sent, t.creator, t.reward);
        if (sent != 0) _totals.held -= sent;
        return r.provider;
    }

    /// @dev The task is open again or has failed: whether this was the last attempt, and the reward is to go back.
    function _endAttempt(TaskId taskId, Record memory t, Cause cause) private returns (bool last) {
        bool named = t.hired != Hire.None;
        Passed passed;
        (last, passed) = queues.endAttempt(taskId, t.serviceId, cause, t.creator, named);
        if (last || t.attempt - passed.count() >= t.maxAttempts) {
            _end(taskId, t, TaskState.Failed);
            emit TaskFailed(taskId, t.reward, t.attempt, cause);
            return true;
        }
        (t.state, t.time, t.price) = (TaskState.Open, block.timestamp, 0);
        if (!named) t.serviceId = NO_SERVICE;
        emit TaskRequeued(taskId, t.attempt, cause);
        _match(taskId, t, passed);
    }

    /// @dev All of `amount`, which is held from now on, arrives, or nothing happened.
    function _take(address from, uint256 amount) private {
        if (amount == 0) return;
        uint256 before = token.balanceOf(address(this));
        // The caller, or who signed what is carried out.
        // slither-disable-next-line arbitrary-send-erc20
        token.safeTransferFrom(from, address(this), amount);
        uint256 received = token.balanceOf(address(this)) - before;
        if (received != amount) revert WrongAmountReceived(amount, received);
    }

    function _pay(address to, uint256 amount) private {
        _totals.held -= _send(0, to, amount);
    }

    /// @dev Returns what is no longer held: what this call has `sent` before, and this payment. A token that refuses `to` holds
    /// up neither the task nor the service: the amount waits for `withdrawPayments`. A token may move an amount and answer
    /// that it did not. What is then missing of everything held was paid, or others' escrow would pay it again.
    function _send(uint120 sent, address to, uint256 amount) private returns (uint120) {
        if (amount == 0) return sent;
        if (!Payments.pay(token, to, amount)) {
            uint256 missing = Math.saturatingSub(_totals.held - sent, token.balanceOf(address(this)));
            uint256 deferred = Math.saturatingSub(amount, missing);
            if (deferred != 0) {
                pendingPayments[to] += deferred;
                emit PaymentDeferred(to, deferred);
            }
            amount -= deferred;
        }
        return sent + uint120(amount);
    }

    function _get(TaskId taskId) private view returns (Record memory t) {
        _load(taskId, t);
        _tasks.loadConditions(t);
    }

    /// @dev The task without its conditions, which members of Record say of themselves.
    function _progress(TaskId taskId) private view returns (Record memory t) {
        _load(taskId, t);
    }

    function _load(TaskId taskId, Record memory t) private view {
        _tasks.load(taskId, _unit, t);
        if (t.state == TaskState.None) revert UnknownTask(taskId);
    }

    /// @dev Until then a ruling can be replaced.
    function _caseEnd(Record memory t) private pure returns (uint256) {
        return t.time + t.verdictWindow + t.auditWindow;
    }

    function _requireState(TaskId taskId, Record memory t, TaskState expected) private view {
        if (t.state != expected) revert WrongState(taskId, t.state, expected);
    }

    function _requireAttempt(TaskId taskId, Record memory t, uint8 attempt) private pure {
        if (attempt != t.attempt) revert WrongAttempt(taskId, t.attempt, attempt);
    }

    function _requireOver(TaskId taskId, uint256 end) private view {
        if (block.timestamp <= end) revert DeadlineNotPassed(taskId, end, block.timestamp);
    }

    /// @dev The caller is the executor of the named attempt, which is under way.
    function _requireExecutor(TaskId taskId, Record memory t, uint8 attempt)
        private
        view
        returns (address executor)
    {
        _requireState(taskId, t, TaskState.Assigned);
        _requireAttempt(taskId, t, attempt);
        if (block.timestamp > t.time) revert DeadlinePassed(taskId, t.time, block.timestamp);
        executor = _workers[t.serviceId].executor;
        address caller = _sender();
        if (caller != executor) revert NotExecutor(taskId, caller, executor);
    }

    /// @dev The caller, or the signer whose request SignedRequests sends.
    function _sender() private view returns (address) {
        return Relayed.sender(signedRequests);
    }

    /// @dev Until then the executor of an assigned task may abandon it at no cost.
    function _graceEnd(Record memory t) private view returns (uint256) {
        return t.time - t.executionWindow + t.grace;
    }

    /// @dev The caller judges tasks of this number.
    /// @return afterRemoval whether that is because its judge was removed
    function _requireJudge(KindId kindId) private view returns (bool afterRemoval) {
        Bench storage bench = _benches[kindId];
        afterRemoval = bench.removed;
        address judge = bench.judge;
        if (afterRemoval) {
            address auditors = address(organization.auditors());
            // Auditors that were removed as a kind's judge are no auditors of its tasks either.
            judge = auditors == judge ? address(0) : auditors;
        }
        if (msg.sender != judge) revert NotJudge(msg.sender, kindId);
    }

    /// @dev A ruling can be made now, says something, and pays what it may.
    function _requireRuling(TaskId taskId, Record memory t, Ruling ruling, uint256 amount, uint256 until)
        private
        view
    {
        if (t.state != TaskState.Ruled) _requireState(taskId, t, TaskState.Submitted);
        uint256 caseEnd = _caseEnd(t);
        if (block.timestamp > caseEnd) revert CaseOver(taskId, caseEnd, block.timestamp);
        if (until != 0 && (until <= block.timestamp || until > caseEnd)) {
            revert InvalidUntil(taskId, until, caseEnd);
        }
        if (ruling == Ruling.None) revert NoRuling(taskId);
        uint256 max = ruling == Ruling.Accepted ? t.price : 0;
        if (amount > max || (amount == 0 && max != 0)) revert InvalidAmount(taskId, amount, max);
    }

    /// @dev The proof that waits for its ruling, or has one that stands; 0 if there is none.
    function _proof(TaskId taskId, Record memory t) private view returns (bytes32) {
        if (t.state == TaskState.Submitted) return _workers[t.serviceId].proof;
        return t.state == TaskState.Ruled ? _standing[taskId].proofHash : bytes32(0);
    }

    /// @dev Whom the task names, in the numbers of ITaskQueues.put.
    function _named(Record memory t) private view returns (uint160) {
        if (t.hired == Hire.Provider) return uint160(_workers[t.serviceId].executor);
        return t.hired == Hire.Service ? t.serviceId.pack() : 0;
    }

    function _outcome(Cause cause) private pure returns (Outcome) {
        if (cause == Cause.Rejected) return Outcome.Rejected;
        if (cause == Cause.GivenUp) return Outcome.GivenUp;
        if (cause == Cause.Void) return Outcome.Void;
        if (cause == Cause.NotAccepted) return Outcome.Missed;
        if (cause == Cause.AbandonedLate) return Outcome.AbandonedLate;
        return cause == Cause.Abandoned ? Outcome.Abandoned : Outcome.Expired;
    }

    function _requireServiceManager() private view {
        if (msg.sender != address(services)) revert NotServiceManager(msg.sender);
    }

    function _requireOrganization() private view {
        if (msg.sender != address(organization)) revert NotOrganization(msg.sender);
    }
}
